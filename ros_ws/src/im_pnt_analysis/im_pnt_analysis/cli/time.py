"""``pnt time``: how often, how full, how busy in the long run; how long a command takes, and why."""

import argparse
import json
from dataclasses import asdict

from im_pnt.model.net import Net
from im_pnt.netfile import load_net
from im_pnt_analysis.cli.terminal import OK, ProgressLine, refuse_without_effect
from im_pnt_analysis.timed.durations import CommandDuration, expected_command
from im_pnt_analysis.timed.steady import SteadyState, steady_state

_DESCRIPTION = """Computes the steady state of timed nets: throughput of transitions, mean tokens and use of places.

Exact for exponential delays, and for others where one thing happens at a time; 'scripts/im pnt simulate --summary'
estimates the rest. With --command: the expected duration of a command from its symbol to its answer, where its time
goes, and its bottleneck, exact where means decide and by simulation otherwise. Symbols and callers come as soon as the
nets have nothing else to do; guards are true as often as 'weight' says."""

_MARKINGS_S, _RUNS = 60.0, 1000
_MARKINGS_SHOWN = 1000


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.description = _DESCRIPTION
    parser.set_defaults(run=run)
    parser.add_argument("files", nargs="+", metavar="FILE", help="net files; several are composed")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--timeout", type=float, metavar="S", help=f"CPU time for the markings [s] ({_MARKINGS_S:g})")
    parser.add_argument("--command", dest="symbol", metavar="SYMBOL", help="expected duration of this command")
    parser.add_argument("--runs", type=int, metavar="N", help=f"with --command: simulated runs ({_RUNS})")
    parser.add_argument("--seed", type=int, metavar="N", help="with --command: seed of the runs (0)")


def run(options: argparse.Namespace) -> int:
    """Compute times of net files."""
    nets = [load_net(file) for file in options.files]
    if options.symbol is None:
        refuse_without_effect(options, ("--runs", "--seed"), "without --command")
        _steady(nets, options)
    else:
        refuse_without_effect(options, ("--timeout",), "with --command")
        _command(nets, options)
    return OK


def _steady(nets: list[Net], options: argparse.Namespace) -> None:
    seconds = _MARKINGS_S if options.timeout is None else options.timeout
    state = steady_state(nets, seconds=seconds)
    name = "+".join(net.name for net in nets)
    print(json.dumps(_plain(state), indent=1) if options.json else f"{name}: {_readable(state)}")


def _command(nets: list[Net], options: argparse.Namespace) -> None:
    runs = _RUNS if options.runs is None else options.runs
    with ProgressLine() as progress:
        expected = expected_command(nets, options.symbol, seed=options.seed or 0, runs=runs, progress=progress)
    if options.json:
        print(json.dumps({**asdict(expected), "bottleneck": expected.bottleneck.transition}, indent=1))
    else:
        print(_duration(expected))


def _plain(state: SteadyState) -> dict[str, object]:
    data: dict[str, object] = {
        "tangible": state.tangible,
        "vanishing": state.vanishing,
        "throughput": state.throughput,
        "mean_tokens": state.mean_tokens,
        "marked": state.marked,
        "busy": state.busy,
        "tokens": {place: dict(sorted(shares.items())) for place, shares in state.tokens.items()},
        "probability": None,
        "classes": [asdict(c) for c in state.classes],
        "method": state.method,
        "assumptions": list(state.assumptions),
        "time_s": round(state.time_s, 4),
    }
    if len(state.probability) <= _MARKINGS_SHOWN:
        data["probability"] = [{"marking": marking, "share": share} for marking, share in state.probability]
    return data


def _readable(state: SteadyState) -> str:
    lines = [
        f"steady state of {state.tangible} tangible and {state.vanishing} vanishing markings, {state.time_s:.3f} s",
        f"  method         {state.method}",
    ]
    for number, c in enumerate(state.classes, start=1):
        marking = ", ".join(f"{place}={count}" for place, count in c.marking.items())
        if c.dead:
            lines.append(f"  stuck          with probability {c.probability:.6g} with {marking or 'no tokens'}")
        elif len(state.classes) > 1:
            lines.append(
                f"  class {number:<8d} with probability {c.probability:.6g}, {c.markings} markings, e.g. {marking}"
            )
    width = max(len(name) for name in (*state.throughput, *state.mean_tokens))
    lines.append(f"  {'transition':{width}}  {'firings [1/s]':>22}  {'busy':>10}")
    for name, value in state.throughput.items():
        if value:
            share = state.busy.get(name.removesuffix(".start"))
            busy = "" if share is None else f"{share:10.4f}"
            lines.append(f"  {name:{width}}  {value:22.6g}  {busy}".rstrip())
    silent = sum(not value for value in state.throughput.values())
    lines.append(f"  {'place':{width}}  {'mean tokens':>22}  {'marked':>10}")
    for name, value in state.mean_tokens.items():
        if value:
            lines.append(f"  {name:{width}}  {value:22.6g}  {state.marked[name]:10.4f}")
    if silent:
        lines.append(f"  ({silent} transitions never fire in the long run)")
    lines.extend(f"  assumed        {text}" for text in state.assumptions)
    return "\n".join(lines)


def _duration(expected: CommandDuration) -> str:
    low, median, high = expected.quantiles
    error = f" +- {expected.half_width:.3g}" if expected.half_width else ""
    lines = [
        f"{expected.symbol}: {expected.mean:.6g}{error} s expected, {expected.method}",
        f"  {expected.runs} runs    5 % took up to {low:.4g} s, half {median:.4g} s, 95 % {high:.4g} s",
        f"  done         with probability {expected.done:.4g}",
        f"  bottleneck   {expected.bottleneck.transition}: {expected.bottleneck.critical:.4g} s hang on it",
    ]
    width = max(len(action.transition) for action in expected.actions)
    lines.append(f"  {'action':{width}}  {'times':>8}  {'each [s]':>9}  {'share':>7}  {'critical [s]':>12}")
    lines.extend(
        f"  {action.transition:{width}}  {action.firings:8.3f}  {action.mean:9.4g}  {action.share:7.1%}"
        f"  {action.critical:12.4g}"
        for action in expected.actions
        if action.mean > 0.0
    )
    lines.extend(f"  assumed      {text}" for text in expected.assumptions)
    return "\n".join(lines)
