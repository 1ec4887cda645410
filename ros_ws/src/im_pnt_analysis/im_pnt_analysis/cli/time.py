"""``pnt time``: how often, how full, how busy in the long run; how long a command takes, and why."""

import argparse
import json
from collections.abc import Mapping
from dataclasses import asdict
from fractions import Fraction
from pathlib import Path

from im_core.errors import ImError
from im_pnt.model.net import Net
from im_pnt.netfile import load_net
from im_pnt_analysis.cli.terminal import OK, ProgressLine, refuse_without_effect
from im_pnt_analysis.timed.durations import CommandDuration, expected_command
from im_pnt_analysis.timed.measurement import Comparison, Measurement, compare, fit_delays, read_measurement
from im_pnt_analysis.timed.steady import Number, SteadyState, steady_state

_DESCRIPTION = """Computes the steady state of timed nets: throughput of transitions, mean tokens and use of places.

Exact for exponential delays, and for others where one thing happens at a time; 'scripts/im pnt simulate --summary'
estimates the rest. With --command: the expected duration of a command from its symbol to its answer, where its time
goes, and its bottleneck, exact where means decide and by simulation otherwise. Symbols and callers come as soon as the
nets have nothing else to do; guards are true as often as 'weight' says."""

_MARKINGS_S, _RUNS = 60.0, 1000
_MARKINGS_SHOWN = 1000
_NAMES_SHOWN = 5
_DIGITS_SHOWN = 9
_DIGITS_WRITTEN = 80


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.description = _DESCRIPTION
    parser.set_defaults(run=run)
    parser.add_argument("files", nargs="+", metavar="FILE", help="net files; several are composed")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--timeout", type=float, metavar="S", help=f"CPU time for the markings [s] ({_MARKINGS_S:g})")
    parser.add_argument("--approximate", action="store_true", help="take all delays for exponential ones")
    parser.add_argument("--command", dest="symbol", metavar="SYMBOL", help="expected duration of this command")
    parser.add_argument("--measured", metavar="FILE", help="with --command: firings to compare with (JSON)")
    parser.add_argument("--fit", action="store_true", help="take delays, success and weights from --measured")
    parser.add_argument("--runs", type=int, metavar="N", help=f"with --command: simulated runs ({_RUNS})")
    parser.add_argument("--seed", type=int, metavar="N", help="with --command: seed of the runs (0)")
    parser.add_argument("-o", "--output", metavar="OUT", help="drawing to write, .svg or .png")


def run(options: argparse.Namespace) -> int:
    """Compute times of net files."""
    output = None if options.output is None else Path(options.output)
    if output is not None and output.suffix not in (".svg", ".png"):
        raise ImError(f"cannot draw into '{output}': the name must end in .svg or .png", code="input")
    nets = [load_net(file) for file in options.files]
    measured = None if options.measured is None else read_measurement(options.measured, nets)
    if options.fit:
        if measured is None:
            raise ImError("--fit needs measured times: give --measured FILE", code="input")
        _check_fits(options.measured, measured, nets)
        nets = list(fit_delays(nets, measured.firings))
    if options.symbol is None:
        refuse_without_effect(options, ("--runs", "--seed"), "without --command")
        if measured is not None and not options.fit:
            raise ImError("--measured needs a command to compare with, or --fit: give --command SYMBOL", code="input")
        _steady(nets, options, output)
    else:
        refuse_without_effect(options, ("--timeout", "--approximate"), "with --command")
        _command(nets, options, measured, output)
    return OK


def _check_fits(file: str, measured: Measurement, nets: list[Net]) -> None:
    """Check whether measured times belong to the given nets.

    Raises:
        ImError: None is of them, or one is of a transition that its net does not have.
    """
    fired = {tuple(name.split(".", 1)) for name in measured.by_transition()}
    own = {(net.name, transition) for net in nets for transition in net.transitions}
    if not fired & own:
        text = f"'{file}' has no firing of a transition of {', '.join(net.name for net in nets)}"
        raise ImError(f"{text}; it has {', '.join(sorted(measured.by_transition())[:_NAMES_SHOWN])}", code="input")
    names = {net.name for net in nets}
    for net, *transition in sorted(fired - own):
        if net in names and "." not in "".join(transition):  # those with one are made when a net is loaded
            raise ImError(f"'{file}' is of another version of net {net}: it has no {''.join(transition)}", code="input")


def _steady(nets: list[Net], options: argparse.Namespace, output: Path | None) -> None:
    seconds = _MARKINGS_S if options.timeout is None else options.timeout
    state = steady_state(nets, approximate=options.approximate, seconds=seconds)
    name = "+".join(net.name for net in nets)
    print(json.dumps(_plain(state), indent=1) if options.json else f"{name}: {_readable(state)}")
    if output is not None:
        from im_pnt_analysis.timed.plot import plot_steady

        plot_steady(name, state, output)


def _command(nets: list[Net], options: argparse.Namespace, measured: Measurement | None, output: Path | None) -> None:
    runs = _RUNS if options.runs is None else options.runs
    with ProgressLine() as progress:
        expected = expected_command(nets, options.symbol, seed=options.seed or 0, runs=runs, progress=progress)
    comparison = None
    if measured is not None:
        times = measured.commands.get(options.symbol)
        comparison = compare(expected, measured.by_transition(), sum(times) / len(times) if times else None)
    if options.json:
        data = {**asdict(expected), "bottleneck": expected.bottleneck.transition}
        if comparison is not None:
            data["comparison"] = asdict(comparison)
        print(json.dumps(data, indent=1))
    else:
        print(_duration(expected))
        if comparison is not None:
            print(_comparison(comparison))
    if output is not None:
        from im_pnt_analysis.timed.plot import plot_command

        plot_command(expected, comparison, output)


def _plain(state: SteadyState) -> dict[str, object]:
    def floats(values: Mapping[str, Number]) -> dict[str, float]:
        return {name: float(value) for name, value in values.items()}

    data: dict[str, object] = {
        "tangible": state.tangible,
        "vanishing": state.vanishing,
        "throughput": floats(state.throughput),
        "mean_tokens": floats(state.mean_tokens),
        "marked": floats(state.marked),
        "busy": floats(state.busy),
        "tokens": {
            place: {str(count): float(share) for count, share in sorted(shares.items())}
            for place, shares in state.tokens.items()
        },
        "probability": None,
        "classes": [{**asdict(c), "probability": float(c.probability)} for c in state.classes],
        "method": state.method,
        "approximation": list(state.approximation),
        "assumptions": list(state.assumptions),
        "time_s": round(state.time_s, 4),
    }
    if len(state.probability) <= _MARKINGS_SHOWN:
        data["probability"] = [
            {"marking": marking, "share": float(share), "fraction": _fraction(share, _DIGITS_WRITTEN)}
            for marking, share in state.probability
        ]
    if any(isinstance(value, Fraction) for value in state.throughput.values()):
        data["fractions"] = {
            "throughput": {name: _fraction(value, _DIGITS_WRITTEN) for name, value in state.throughput.items()},
            "mean_tokens": {name: _fraction(value, _DIGITS_WRITTEN) for name, value in state.mean_tokens.items()},
        }
    return data


def _fraction(value: Number, digits: int) -> str | None:
    """Return a fraction as text, None for no fraction or one with too many digits."""
    if not isinstance(value, Fraction) or value.denominator.bit_length() > 4 * digits:
        return None
    text = str(value)
    return text if len(text) <= digits else None


def _number(value: Number) -> str:
    decimal = f"{float(value):.6g}"
    exact = _fraction(value, _DIGITS_SHOWN)
    return decimal if exact is None or "/" not in exact else f"{exact} = {decimal}"


def _readable(state: SteadyState) -> str:
    lines = [
        f"steady state of {state.tangible} tangible and {state.vanishing} vanishing markings, {state.time_s:.3f} s",
        f"  method         {state.method}",
    ]
    if state.approximation:
        lines.append(f"  APPROXIMATION  taken for exponential, by their mean: {', '.join(state.approximation)}")
    for number, c in enumerate(state.classes, start=1):
        marking = ", ".join(f"{place}={count}" for place, count in c.marking.items())
        if c.dead:
            lines.append(f"  stuck          with probability {_number(c.probability)} with {marking or 'no tokens'}")
        elif len(state.classes) > 1:
            lines.append(
                f"  class {number:<8d} with probability {_number(c.probability)}, {c.markings} markings, e.g. {marking}"
            )
    width = max(len(name) for name in (*state.throughput, *state.mean_tokens))
    lines.append(f"  {'transition':{width}}  {'firings [1/s]':>22}  {'busy':>10}")
    for name, value in state.throughput.items():
        if value:
            share = state.busy.get(name.removesuffix(".start"))
            busy = "" if share is None else f"{float(share):10.4f}"
            lines.append(f"  {name:{width}}  {_number(value):>22}  {busy}".rstrip())
    silent = sum(not value for value in state.throughput.values())
    lines.append(f"  {'place':{width}}  {'mean tokens':>22}  {'marked':>10}")
    for name, value in state.mean_tokens.items():
        if value:
            lines.append(f"  {name:{width}}  {_number(value):>22}  {float(state.marked[name]):10.4f}")
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


def _comparison(comparison: Comparison) -> str:
    lines = []
    if comparison.measured is not None:
        verdict = "between" if comparison.plausible else "NOT between"
        lines.append(f"  measured     {comparison.measured:.6g} s, {verdict} the expected 5 % and 95 %")
    width = max((len(row.transition) for row in comparison.actions), default=0)
    lines.append(f"  {'expected / measured':{width}}  {'times':>19}  {'each [s]':>23}")
    for row in comparison.actions:
        if not (row.expected_mean or row.measured_mean):
            continue
        each = "-" if row.measured_mean is None else f"{row.measured_mean:.4g}"
        lines.append(
            f"  {row.transition:{width}}  {row.expected_firings:10.3f} {row.measured_firings:8d}"
            f"  {row.expected_mean:12.4g} {each:>10}"
        )
    return "\n".join(lines)
