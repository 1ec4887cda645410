"""``pnt``: verify, simulate and draw net files."""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from im_core.errors import ImError
from im_pnt.analysis.reachability import Limits
from im_pnt.analysis.verify import Report, verify
from im_pnt.draw import dot, draw, svg
from im_pnt.netfile import load_net
from im_pnt.simulate import simulate

OK, REFUSED, BAD_INPUT = 0, 1, 2

_DESCRIPTION = """Works on Petri net transducers: YAML files with places, transitions, tapes, guards and actions.

  pnt verify dispatcher.yaml motion_coordinator.yaml   may these nets run together?
  pnt simulate dispatcher.yaml --seed 7 --steps 50     plays a net with imagined actions
  pnt draw dispatcher.yaml -o dispatcher.svg           draws it (.svg or .dot)

Exit code: 0 done or verified, 1 the net is refused, 2 a file or an option is wrong."""

_VERIFY = """Searches every marking that the nets can reach, alone or composed over remote places and services.

A net is refused when a place can grow without end or over its capacity, when it can get stuck (waiting for a symbol
or a caller at rest is not stuck; 'rest:' in the file names the places that may hold tokens then), or when a command it
once took can become impossible for ever. The shortest firing sequence that shows it is printed. Guards are taken to be
either true or false; the tape is free: any symbol may come at any time."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs ``pnt``.

    Args:
        arguments: Command line without the program's name; None: that of the process.

    Returns:
        Exit code.
    """
    options = _parser().parse_args(arguments)
    try:
        match options.command:
            case "verify":
                return _verify(options)
            case "simulate":
                return _simulate(options)
            case _:
                return _draw(options)
    except ImError as error:
        print(f"pnt: {error}", file=sys.stderr)
        return REFUSED if error.code == "net_refused" else BAD_INPUT
    except BrokenPipeError:
        sys.stderr.close()
        return OK


def _parser() -> argparse.ArgumentParser:
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser("pnt", description=_DESCRIPTION, formatter_class=raw)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    check = commands.add_parser("verify", help="may the nets run?", description=_VERIFY, formatter_class=raw)
    check.add_argument("files", nargs="+", metavar="FILE", help="net files; several are composed")
    check.add_argument("--json", action="store_true", help="print one JSON object with every answer")
    check.add_argument("--timeout", type=float, default=30.0, metavar="S", help="time for the search [s] (30)")
    check.add_argument("--states", type=int, default=1_000_000, metavar="N", help="markings to search (1000000)")
    play = commands.add_parser("simulate", help="play a net", description="Fires a net with imagined actions.")
    play.add_argument("files", nargs="+", metavar="FILE", help="net files; several are composed")
    play.add_argument("--seed", type=int, default=0, metavar="N", help="same seed, same run (0)")
    play.add_argument("--steps", type=int, default=100, metavar="N", help="firings at most (100)")
    paint = commands.add_parser("draw", help="draw a net", description="Draws a net file.")
    paint.add_argument("file", metavar="FILE", help="net file")
    paint.add_argument("-o", "--output", required=True, metavar="OUT", help="file to write, .svg or .dot")
    paint.add_argument("--phases", action="store_true", help="draw start, active, end and failed of timed transitions")
    return parser


def _verify(options: argparse.Namespace) -> int:
    nets = [load_net(file) for file in options.files]
    report = verify(nets, Limits(states=options.states, seconds=options.timeout))
    print(json.dumps(report.to_dict(), indent=1) if options.json else _readable(report))
    return OK if report.ok else REFUSED


def _readable(report: Report) -> str:
    def answer(value: object, name: str) -> str:
        if value is None:
            return f"unknown ({report.unknown.get(name, 'not asked')})"
        return {True: "yes", False: "no"}.get(value, str(value)) if isinstance(value, bool) else str(value)

    lines = [
        f"{'+'.join(report.nets)}: {'verified' if report.ok else 'REFUSED'}",
        f"  markings      {report.states} ({report.labelled_arcs} firings), {report.time_s:.3f} s, {report.method}",
        f"  bounded       {answer(report.bounded, 'bounded')}; at most "
        f"{answer(report.max_token_in_place, 'max_token_in_place')} in a place",
        f"  deadlock      {answer(report.has_deadlock, 'has_deadlock')}",
    ]
    if report.never_enabled_transitions:
        lines.append(f"  never enabled {', '.join(report.never_enabled_transitions)}")
    for flow in report.p_semiflows:
        terms = " + ".join(f"{weight} {place}" if weight > 1 else place for place, weight in flow.items())
        lines.append(f"  invariant     {terms}")
    for refusal in report.refusals:
        lines.append(f"  refused       {refusal.reason}")
        lines.append(f"    after       {' -> '.join(refusal.sequence) or '(nothing)'}")
        if refusal.repeat:
            lines.append(f"    repeating   {' -> '.join(refusal.repeat)}")
        marking = ", ".join(f"{place}={count}" for place, count in refusal.marking.items())
        lines.append(f"    marking     {marking or '(empty)'}")
    lines.extend(f"  assumed       {text}" for text in report.assumptions)
    return "\n".join(lines)


def _simulate(options: argparse.Namespace) -> int:
    nets = [load_net(file) for file in options.files]
    end = "nothing can fire"
    for number, step in enumerate(simulate(nets, seed=options.seed, steps=options.steps), start=1):
        marking = ", ".join(f"{place}={count}" for place, count in step.marking.items())
        print(f"{number:5d}  {step.transition:40s} {marking}")
        end = "stopped by --steps" if number == options.steps else end
    print(end)
    return OK


def _draw(options: argparse.Namespace) -> int:
    output = Path(options.output)
    if output.suffix not in (".svg", ".dot"):
        raise ImError(f"cannot draw into '{output}': the name must end in .svg or .dot", code="input")
    drawing = draw(load_net(options.file), phases=options.phases)
    try:
        output.write_text(svg(drawing) if output.suffix == ".svg" else dot(drawing), encoding="utf-8")
    except OSError as error:
        raise ImError(f"cannot write '{output}': {error.strerror}", code="input") from error
    print(f"{output}: {len(drawing.nodes)} nodes, {len(drawing.arcs)} arcs")
    return OK


if __name__ == "__main__":
    sys.exit(main())
