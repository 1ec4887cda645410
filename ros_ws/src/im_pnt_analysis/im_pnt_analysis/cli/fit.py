"""``pnt fit``: times and probabilities of nets, estimated from bags, and written into net files."""

import argparse
import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from im_core.errors import DataError, ImError
from im_core.files import read_text, write_whole
from im_pnt.model.action import RequestAction
from im_pnt.model.net import Net
from im_pnt.netfile import load_net, parse_net
from im_pnt_analysis.cli.terminal import OK
from im_pnt_analysis.recorded.firings import Mission, mission_of
from im_pnt_analysis.timed.durations import expected_command
from im_pnt_analysis.timed.estimation import Interval
from im_pnt_analysis.timed.measurement import MeasuredFiring, TransitionEstimate, estimate, with_estimates
from im_pnt_analysis.timed.rewrite import Rewritten, delay_text, rewrite

_DESCRIPTION = """Estimates from bags how long transitions take (testbed time), how often their actions succeed, and
which of those that contend fires, each with the interval that holds the true value in 95 % of cases. With --nets it
prints what would change in the 'delay', 'success' and 'weight' of these files, as a diff; --write changes them, each
file at one stroke, comments and layout as they are. With --command it predicts how long that command takes, and puts
what the bags hold beside it; --against BAG names a bag that was not used for the estimates.

  scripts/im pnt fit bags/monday bags/tuesday
  scripts/im pnt fit bags/monday --nets ros_ws/src/im_coordinators/im_coordinators/nets/*.yaml --write
  scripts/im pnt fit bags/monday --command calibrate_camera --against bags/tuesday"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.description = _DESCRIPTION
    parser.set_defaults(run=run)
    parser.add_argument("bags", type=Path, nargs="+", metavar="BAG", help="folders of bags, or their files")
    parser.add_argument("--nets", type=Path, nargs="+", default=[], metavar="FILE", help="net files to be changed")
    parser.add_argument("--write", action="store_true", help="write the changes (default: only show them)")
    parser.add_argument("--command", dest="symbol", metavar="SYMBOL", help="predict how long this command takes")
    parser.add_argument("--against", type=Path, metavar="BAG", help="with --command: compare with this bag instead")


def run(options: argparse.Namespace) -> int:
    """Estimate, and write the files if asked to."""
    if options.write and not options.nets:
        raise ImError("--write needs net files to change: give --nets FILE...", code="input")
    if options.against is not None and options.symbol is None:
        raise ImError("--against needs a command to compare with: give --command SYMBOL", code="input")
    files = {path: load_net(path) for path in options.nets}
    missions = {bag: mission_of(bag) for bag in options.bags}
    nets = {name: net for mission in missions.values() for name, net in mission.nets.items()}
    seen = [firing for mission in missions.values() for firing in measured(mission)]
    files = _fitting(files, nets, seen)
    nets |= {net.name: net for net in files.values()}
    found = estimate(list(nets.values()), seen)
    print("\n".join(_table(found)))
    changes = [_change(path, net, found[net.name]) for path, net in files.items()]
    for change in changes:
        print("".join(change.diff()), end="")
    predicted: list[str] = []
    if options.symbol is not None:  # before anything is written: it may be refused
        other = {options.against: mission_of(options.against)} if options.against else missions
        fitted = {name: with_estimates(net, found[name]) for name, net in nets.items()}
        predicted = _prediction(fitted, options.symbol, other)
    for change in changes if options.write else ():
        try:
            write_whole(change.path, change.after.text)
        except OSError as error:
            raise DataError(f"{change.path}: cannot be written: {error.strerror}", file=str(change.path)) from error
        print(f"{change.path}: {change.after.changed} values are new")
    if changes and not options.write:
        print(f"{sum(change.after.changed for change in changes)} values would be new; --write writes them")
    print("".join(f"{line}\n" for line in predicted), end="")
    return OK


def measured(mission: Mission) -> list[MeasuredFiring]:
    """Return the ends of the firings of a mission, in testbed time, without interrupted or earlier ones."""
    return [
        MeasuredFiring(f"{each.net}.{each.transition}", max(each.end_s - each.begin_s, 0.0), each.failed)
        for each in mission.firings
        if each.end_s is not None and each.begun and not each.cancelled
    ]


def command_times(mission: Mission, symbol: str) -> list[float]:
    """Return the duration of each run of a command in a mission, from the symbol to the answer [s]."""
    times, begun = [], dict[tuple[str, int], float]()
    for each in mission.firings:
        net = mission.nets.get(each.net)
        transition = net.transitions.get(each.transition) if net is not None else None
        if transition is None or each.end_s is None:
            continue
        if transition.symbol == symbol:
            begun[each.net, each.command_id] = each.begin_s
        if {f"{symbol}_done", f"{symbol}_failed"} & set(transition.emit) and (each.net, each.command_id) in begun:
            times.append(each.end_s - begun.pop((each.net, each.command_id)))
    return times


@dataclass(frozen=True)
class _Change:
    path: Path
    before: str
    after: Rewritten

    def diff(self) -> Iterable[str]:
        """Return the changes, in the form of ``diff -u``, and the unwritable ones."""
        before, after = (text.splitlines(keepends=True) for text in (self.before, self.after.text))
        yield from difflib.unified_diff(before, after, str(self.path), f"{self.path} (fitted)")
        if self.after.elsewhere:
            names = ", ".join(self.after.elsewhere)
            yield f"{self.path}: made by templates, 'tries' or anchors, to be written by hand: {names}\n"


def _change(path: Path, net: Net, found: Mapping[str, TransitionEstimate]) -> _Change:
    before = read_text(path)
    after = rewrite(before, net, found)
    parse_net(after.text, str(path), path)
    return _Change(path, before, after)


def _fitting(files: Mapping[Path, Net], nets: Mapping[str, Net], seen: Sequence[MeasuredFiring]) -> dict[Path, Net]:
    """Return the files with fired nets; report the other nets of the bags as unchanged.

    Raises:
        DataError: One cannot be changed, or is of no net in the bags, or of another version of one.
    """
    fitting = {}
    for path, net in files.items():
        if path.suffix.lower() not in (".yaml", ".yml"):
            raise DataError(f"{path}: only net files in YAML can be changed", file=str(path))
        fired = {each.transition.removeprefix(f"{net.name}.") for each in seen if _net_of(each) == net.name}
        if not fired and net.name in nets:
            print(f"{path}: its net {net.name} has not fired in the bags: it stays as it is")
            continue
        if not fired:
            known = ", ".join(sorted(nets)) or "none is described"
            raise DataError(f"{path}: its net {net.name} has not fired in the bags; nets there: {known}")
        own = {
            name for name in fired if "." not in name
        }  # others, such as accept.SERVICE, are made when a net is loaded
        if unknown := sorted(own - net.transitions.keys()):
            raise DataError(f"{path}: the bags are of another version of net {net.name}: it has no {unknown[0]}")
        fitting[path] = net
    return fitting


def _net_of(firing: MeasuredFiring) -> str:
    return firing.transition.partition(".")[0]


def _table(found: Mapping[str, Mapping[str, TransitionEstimate]]) -> list[str]:
    rows = ["count  success (95 %)             share (95 %)              net and transition: delay (95 %)"]
    for net, transitions in found.items():
        for name, each in transitions.items():
            if each.delay is None and each.share is None:
                continue
            delay = "" if each.delay is None else f": {delay_text(each.delay.delay)}"
            if each.delay is not None and each.delay.intervals:
                delay += f" ({', '.join(f'{key} {_span(span)}' for key, span in each.delay.intervals.items())})"
            rows.append(f"{each.count:5d}  {_share(each.success):25s}  {_share(each.share):25s} {net}.{name}{delay}")
    return rows


def _share(share: tuple[float, Interval] | None) -> str:
    return "-" if share is None else f"{share[0]:.4g} ({_span(share[1])})"


def _span(span: Interval) -> str:
    return f"{span.low:.4g} to {span.high:.4g}"


def _prediction(nets: Mapping[str, Net], symbol: str, missions: Mapping[Path, Mission]) -> list[str]:
    """Return the predicted duration of a command by the fitted nets, and the measured one."""
    expected = expected_command(_needed(nets, symbol), symbol)
    low, median, high = expected.quantiles
    lines = [f"{symbol}: {expected.mean:.4g} s expected; 9 of 10 between {low:.4g} and {high:.4g} s, half {median:.4g}"]
    took = [(bag, time) for bag, mission in missions.items() for time in command_times(mission, symbol)]
    lines += [f"{bag}: {time:.4g} s, {'between' if low <= time <= high else 'NOT between'} these" for bag, time in took]
    if not took:
        raise DataError(f"{', '.join(map(str, missions))}: no {symbol} has ended there")
    return lines


def _needed(nets: Mapping[str, Net], symbol: str) -> list[Net]:
    """Return the net of a symbol, with the nets of all direct and indirect services."""
    readers = [net for net in nets.values() if any(t.symbol == symbol for t in net.transitions.values())]
    if not readers:
        raise DataError(f"no net in the bags reads the symbol {symbol}")
    chosen = readers[:1]
    for net in chosen:
        asked = [t.action.net for t in net.transitions.values() if isinstance(t.action, RequestAction)]
        chosen += [nets[name] for name in dict.fromkeys(asked) if name in nets and nets[name] not in chosen]
    return chosen
