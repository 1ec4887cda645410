"""``pnt verify``: may the nets run together?"""

import argparse
import json
import os
from collections.abc import Sequence
from pathlib import Path

from im_core import plugins
from im_core.clock import cpu
from im_core.files import is_same
from im_core.names import CELL
from im_core.options import at_least, computing_seconds
from im_core.plugins import extensions
from im_pnt.errors import NetError
from im_pnt.expression.scope import check_net
from im_pnt.expression.types import MessageTypes
from im_pnt.model.action import AwaitAction, GoalAction, ServiceAction, TopicAction
from im_pnt.model.net import Net
from im_pnt.netfile import load_net
from im_pnt_analysis.cli.terminal import OK, REFUSED, UNPROVED, EndOnInterrupt, ProgressLine, titles, write_output
from im_pnt_analysis.search.limits import SearchLimits
from im_pnt_analysis.verify.files import check_files
from im_pnt_analysis.verify.load import LOAD_LIMITS, verify_to_start
from im_pnt_analysis.verify.report import Report, readable, refusal_text

_DESCRIPTION = f"""Searches every marking that the nets can reach, as the start of a machine does: each net alone, and
then those that talk to each other together, as far as they must be. The verdict comes first.

Nets are refused
  when a place can grow without end or over its capacity;
  when they can get stuck (waiting for a symbol or a caller at rest is not stuck; 'rest:' in the file names the places
  that may hold tokens then);
  when a command or service that was possible can become impossible for ever;
  when a place that is marked at first may never get its tokens back (in nets without 'rest:').
The shortest firing sequence that shows it is printed. Guards are taken to be either true or false; the tape is free:
any symbol may come at any time.

Before that the files are looked at: commands that never end, needs that no cell has, functions that cannot be imported,
and, where ROS was sourced, values that do not fit the messages that they go into.

What was proved is kept ($XDG_CACHE_HOME/im/proofs). A machine finds it there, and gives each verification that is left
{LOAD_LIMITS.seconds:g} s of CPU time.

Exit code: 0 verified, 1 refused, 2 a file or an option is wrong, 3 not refused, but not proved either."""

FIT = "values fit the types of the messages"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.description = _DESCRIPTION
    parser.set_defaults(run=run)
    add = parser.add_argument
    add("files", nargs="+", metavar="FILE", help="net files; of a machine all of them")
    add("--cell", metavar="CELL", help="cell of nets with `parameters`: a shipped one, or a cell file (puma_pair)")
    add("--json", action="store_true", help="print one JSON object with every answer")
    add(
        "--all",
        action="store_true",
        help="print every answer, refusal, invariant and assumption, not the verdict alone",
    )
    add("--timeout", type=computing_seconds, metavar="S", help="CPU time for each verification [s] (60)")
    add("--states", type=at_least(1), default=20_000_000, metavar="N", help="markings to list (20000000)")
    add("--counterexample", metavar="FILE", help="write what 'scripts/im pnt simulate --replay' plays, if refused")
    add("--loaded", action="store_true", help="nets that nodes have loaded: look at no functions, read kept proofs")


def run(options: argparse.Namespace) -> int:
    """Verify net files."""
    if options.counterexample and any(is_same(options.counterexample, file) for file in options.files):
        raise NetError(f"--counterexample {options.counterexample} is one of the nets", file=options.counterexample)
    if options.cell is not None:
        os.environ[CELL] = options.cell
    if options.loaded:
        return _verify_loaded(options)
    with EndOnInterrupt("\npnt: verification interrupted, nothing is decided"), ProgressLine() as progress:
        nets = [load_net(file) for file in options.files]
        types = checked_types(nets)
        plugins.find_beside(options.files)
        endless = check_files(nets, [name for named in extensions("im_pnt.resources") for name in named()])
        from im_pnt_analysis.verify.together import verify_files  # all that searches; the start of a machine needs none

        limits = SearchLimits(states=options.states, seconds=options.timeout or 60.0)
        report = verify_files(nets, limits, structure=options.json, progress=progress)
    if options.counterexample and report.refusals:
        _write_counterexample(options.counterexample, options.files, nets, report)
    if options.json:
        print(json.dumps(report.to_dict() | {"types": types}, indent=1))
    else:
        said = [("types", types)] if types and (options.all or types != FIT) else []
        said += [("told", sentence) for sentence in endless]
        named = titles([net for net in nets if net.name in report.nets])
        print("\n".join([readable(report, named, options.all), *(f"  {key:<14}{text}" for key, text in said)]))
    return OK if report.ok else REFUSED if report.refusals else UNPROVED


def _verify_loaded(options: argparse.Namespace) -> int:
    """Verify the nets of a machine, one line each; the last printed line is the verdict."""
    began = cpu()
    seconds = options.timeout or LOAD_LIMITS.seconds
    limits = SearchLimits(states=int(max(1.0, seconds / LOAD_LIMITS.seconds) * LOAD_LIMITS.states), seconds=seconds)
    anew, unproved = 0, ""
    nets = [load_net(file) for file in options.files]
    for report in verify_to_start(nets, limits):
        if report.refusals:
            print(refusal_text(report))
            return REFUSED
        print(report.sentence, flush=True)
        anew += not report.proved_before
        unproved = unproved or (report.sentence if report.unproved else "")
    took = f"verified in {cpu() - began:.2f} s of CPU time" if anew else "unchanged since verified"
    print(unproved or f"{len(nets)} {'net' if len(nets) == 1 else 'nets'} {took}")
    return UNPROVED if unproved else OK


def _write_counterexample(path: str, files: list[str], nets: list[Net], report: Report) -> None:
    from im_pnt_analysis.simulation.replay import FiringSequence

    refusal = report.refusals[0]
    firings = FiringSequence(refusal.sequence, refusal.repeat, refusal.reason)
    shown = report.composed or nets
    content: dict[str, object] = {}
    for drawn in extensions("im_pnt.counterexamples"):
        content |= drawn(shown, firings)
    names = [net.name for net in shown]
    content |= {
        "nets": names,
        "files": [file for file, net in zip(files, nets, strict=True) if net.name in names],
        "kind": refusal.kind,
        "reason": refusal.reason,
        "sequence": [*refusal.sequence, *refusal.repeat],
        "repeat_from": len(refusal.sequence) if refusal.repeat else None,
        "marking": refusal.marking,
    }
    write_output(Path(path), json.dumps(content, indent=1) + "\n", overwrite=True)


def checked_types(nets: Sequence[Net]) -> str:
    """Check the values in requests, objects and guards of nets.

    Returns:
        What was done, in one line; empty where the nets name no types.

    Raises:
        NetFileError: A value does not fit, or there is no such type; names file, line, column and what is allowed.
    """
    kinds = (ServiceAction, GoalAction, TopicAction, AwaitAction)
    named = any(isinstance(t.action, kinds) for net in nets for t in net.transitions.values())
    if not named and not any(place.object_type for net in nets for place in net.places.values()):
        return ""
    later = "a node checks them when it loads the nets"
    try:
        makers = list(extensions("im_pnt.message_types"))
    except ModuleNotFoundError as error:
        return f"not checked: there is no ROS here ({error.name} is not found); {later}"
    if not makers:
        return f"not checked: the package im_pnt_node is not installed; {later}"
    types: MessageTypes = makers[0]()
    for net in nets:
        check_net(net, types)
    return FIT
