"""``pnt simulate``: plays nets with imagined actions on a virtual clock, or a given firing sequence."""

import argparse
import json
from collections.abc import Mapping
from dataclasses import asdict

from im_pnt.model.net import Net
from im_pnt.netfile import load_net
from im_pnt_analysis.cli.terminal import OK, ProgressLine, refuse_without_effect, titles
from im_pnt_analysis.simulation.replay import read_firing_sequence, replay
from im_pnt_analysis.simulation.simulate import Estimate, Summary, simulate, summarise

_DESCRIPTION = """Plays nets, alone or composed, by their structure, delays and probabilities.

Actions take their 'delay', as many at once as 'servers' says, and succeed with probability 'success'; alternatives are
taken by priority and 'weight' (times the prior of a strategy); symbols and callers come when the nets have nothing else
to do. Time is virtual.
--replay plays a counterexample as 'scripts/im pnt verify --counterexample FILE' writes it, a file with a transition a
line, or a sequence 'a -> b -> c', and says what is enabled at its end."""

_STEPS = 100
_SUMMARY_STEPS = 100_000


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.description = _DESCRIPTION
    parser.set_defaults(run=run)
    parser.add_argument("files", nargs="+", metavar="FILE", help="net files; several are composed")
    parser.add_argument("--seed", type=int, metavar="N", help="same seed, same run (0)")
    parser.add_argument(
        "--steps", type=int, metavar="N", help=f"firings at most ({_STEPS}, or {_SUMMARY_STEPS} of a summary)"
    )
    parser.add_argument("--until", type=float, metavar="T", help="virtual time to stop at [s]")
    parser.add_argument("--failures", type=float, metavar="P", help="failures of actions without success")
    parser.add_argument("--json", action="store_true", help="print one JSON object a line")
    way = parser.add_mutually_exclusive_group()
    way.add_argument("--summary", action="store_true", help="print averages with 95 %% confidence intervals")
    way.add_argument("--replay", metavar="SEQUENCE", help="play this file or sequence instead")


def run(options: argparse.Namespace) -> int:
    """Play net files."""
    nets = [load_net(file) for file in options.files]
    if not options.json:
        for name, title in titles(nets).items():
            print(f"{name} is called {title}")
    if options.replay is not None:
        refuse_without_effect(options, ("--seed", "--steps", "--until", "--failures"), "with --replay")
        _replay(nets, options)
        return OK
    seed, steps, failures = options.seed or 0, options.steps, options.failures or 0.0
    if steps is None and options.until is None:
        steps = _SUMMARY_STEPS if options.summary else _STEPS
    if options.summary:
        with ProgressLine() as progress:
            summary = summarise(nets, seed=seed, steps=steps, until=options.until, failures=failures, progress=progress)
        print(json.dumps(asdict(summary)) if options.json else _readable(summary))
    else:
        _play(nets, seed, steps, failures, options)
    return OK


def _play(nets: list[Net], seed: int, steps: int | None, failures: float, options: argparse.Namespace) -> None:
    number, time = 0, 0.0
    run = simulate(nets, seed=seed, steps=steps, until=options.until, failures=failures)
    for number, step in enumerate(run, start=1):
        time = step.time
        _show(number, step.time, step.transition, step.marking, options.json)
    end = "nothing can fire"
    if number == steps:
        end = "stopped by --steps"
    elif options.until is not None:
        end = "nothing more can fire, or not before --until"
    print(json.dumps({"end": end, "time": time}) if options.json else end)


def _replay(nets: list[Net], options: argparse.Namespace) -> None:
    firings = read_firing_sequence(options.replay)
    enabled: tuple[str, ...] = ()
    if firings.reason and not options.json:
        print(f"shows: {firings.reason}")
    for step in replay(nets, firings):
        enabled = step.enabled
        _show(step.number, None, step.transition or "(initial marking)", step.marking, options.json)
        if firings.repeat and step.number == len(firings.sequence) and not options.json:
            print("from here on, repeated for ever:")
    if options.json:
        print(json.dumps({"enabled": list(enabled)}))
    else:
        print(f"enabled: {', '.join(enabled)}" if enabled else "stuck: nothing is enabled")


def _show(number: int, time: float | None, transition: str, marking: Mapping[str, int], as_json: bool) -> None:
    if as_json:
        print(json.dumps({"step": number, "time": time, "transition": transition, "marking": marking}))
        return
    tokens = ", ".join(f"{place}={count}" for place, count in marking.items())
    clock = "" if time is None else f"{time:12.4f}  "
    print(f"{number:5d}  {clock}{transition:40s} {tokens}")


def _readable(summary: Summary) -> str:
    def text(estimate: Estimate | None) -> str:
        if estimate is None:
            return ""
        error = "" if estimate.half_width is None else f"+- {estimate.half_width:.2g}"
        return f"{estimate.mean:12.6g} {error}"

    lines = [f"{summary.firings} firings in {summary.time:.6g} s of virtual time"]
    if summary.stuck:
        marking = ", ".join(f"{place}={count}" for place, count in summary.marking.items())
        lines.append(f"  stuck with {marking or 'no tokens'}")
    width = max(len(name) for name in (*summary.counts, *summary.mean_tokens, "transition"))
    lines.append(f"  {'transition':{width}}  {'firings':>9}  {'firings [1/s]':>12}")
    for name, count in summary.counts.items():
        if count:
            lines.append(f"  {name:{width}}  {count:9d}  {text(summary.throughput.get(name))}".rstrip())
    if summary.mean_tokens:
        lines.append(f"  {'place':{width}}  {'':9}  {'mean tokens':>12}")
    for name, estimate in summary.mean_tokens.items():
        if estimate.mean:
            lines.append(f"  {name:{width}}  {'':9}  {text(estimate)}".rstrip())
    lines.extend(f"  assumed  {text}" for text in summary.assumptions)
    return "\n".join(lines)
