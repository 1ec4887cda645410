"""``pnt verify``: may the nets run together?"""

import argparse
import json
from pathlib import Path

from im_core import plugins
from im_core.files import is_same
from im_core.options import at_least, computing_seconds
from im_pnt.errors import NetError
from im_pnt.model.net import Net
from im_pnt.netfile import load_net
from im_pnt_analysis.cli.extensions import extensions
from im_pnt_analysis.cli.terminal import OK, REFUSED, EndOnInterrupt, ProgressLine, titles, write_output
from im_pnt_analysis.cli.types import checked_types
from im_pnt_analysis.search.limits import SearchLimits
from im_pnt_analysis.simulation.replay import FiringSequence
from im_pnt_analysis.verify.files import check_files
from im_pnt_analysis.verify.report import Report, readable
from im_pnt_analysis.verify.verdict import verify

_DESCRIPTION = """Searches every marking that the nets can reach, alone or composed over remote places and services.

Nets are refused
  when a place can grow without end or over its capacity;
  when they can get stuck (waiting for a symbol or a caller at rest is not stuck; 'rest:' in the file names the places
  that may hold tokens then);
  when a command or service that was possible can become impossible for ever;
  when a place that is marked at first may never get its tokens back (in nets without 'rest:').
The shortest firing sequence that shows it is printed. Guards are taken to be either true or false; the tape is free:
any symbol may come at any time.

Values are checked against the types of the messages that they go into, where ROS was sourced; the output says so."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.description = _DESCRIPTION
    parser.set_defaults(run=run)
    parser.add_argument("files", nargs="+", metavar="FILE", help="net files; several are composed")
    parser.add_argument("--json", action="store_true", help="print one JSON object with every answer")
    add = parser.add_argument
    add("--all", action="store_true", help="print every refusal, invariant and assumption, not the verdict alone")
    add("--timeout", type=computing_seconds, default=60.0, metavar="S", help="CPU time for everything [s] (60)")
    add("--states", type=at_least(1), default=20_000_000, metavar="N", help="markings to list (20000000)")
    parser.add_argument(
        "--counterexample",
        metavar="FILE",
        help="where nets are refused, write what 'scripts/im pnt simulate --replay' plays",
    )


def run(options: argparse.Namespace) -> int:
    """Verify net files."""
    if options.counterexample and any(is_same(options.counterexample, file) for file in options.files):
        raise NetError(f"--counterexample {options.counterexample} is one of the nets", file=options.counterexample)
    with EndOnInterrupt("\npnt: verification interrupted, nothing is decided"), ProgressLine() as progress:
        nets = [load_net(file) for file in options.files]
        types = checked_types(nets)
        plugins.find_beside(options.files)
        endless = check_files(nets, [name for named in extensions("im_pnt.resources") for name in named()])
        report = verify(
            nets,
            SearchLimits(states=options.states, seconds=options.timeout),
            structure=options.json,
            progress=progress,
        )
    if options.counterexample and report.refusals:
        _write_counterexample(options.counterexample, options.files, nets, report)
    if options.json:
        print(json.dumps(report.to_dict() | {"types": types}, indent=1))
    else:
        said = [("types", types)] if types else []
        said += [("told", sentence) for sentence in endless]
        print("\n".join([readable(report, titles(nets), options.all), *(f"  {key:<14}{text}" for key, text in said)]))
    return OK if report.ok else REFUSED


def _write_counterexample(path: str, files: list[str], nets: list[Net], report: Report) -> None:
    refusal = report.refusals[0]
    firings = FiringSequence(refusal.sequence, refusal.repeat, refusal.reason)
    content: dict[str, object] = {}
    for drawn in extensions("im_pnt.counterexamples"):
        content |= drawn(nets, firings)
    content |= {
        "nets": report.nets,
        "files": files,
        "kind": refusal.kind,
        "reason": refusal.reason,
        "sequence": [*refusal.sequence, *refusal.repeat],
        "repeat_from": len(refusal.sequence) if refusal.repeat else None,
        "marking": refusal.marking,
    }
    write_output(Path(path), json.dumps(content, indent=1) + "\n", overwrite=True)
