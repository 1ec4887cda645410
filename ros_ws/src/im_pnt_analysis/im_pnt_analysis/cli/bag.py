"""``pnt bag``: report on a recording: the contents, the time line of the mission, gaps, and durations of actions."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from im_pnt_analysis.cli.terminal import OK
from im_pnt_analysis.recorded.firings import ActionTimes, Mission, RecordedFiring, Topic, contents_of, mission_of

_DESCRIPTION = """Tells what a recording holds: topics with their longest silence; the time line of what fired, in
testbed time, with the transition that each one waited for; events of nets that were not recorded; and the duration of
each action beside the mean of its 'delay'. Of a long table the first and last lines are printed; --all prints the rest,
and topics without messages. --picture FILE (.svg or .png) draws the time line."""

#: Lines of each end of a table that is longer than both.
_ENDS = 30


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.description = _DESCRIPTION
    parser.set_defaults(run=run)
    parser.add_argument("bag", type=Path, metavar="BAG", help="folder of the bag, or a file of it")
    parser.add_argument("--all", action="store_true", help="print every line of every table")
    parser.add_argument("--picture", type=_drawing, metavar="FILE", help="draw the time line into this .svg or .png")


def run(options: argparse.Namespace) -> int:
    """Report on a bag."""
    topics, mission = contents_of(options.bag), mission_of(options.bag)
    tables = {
        "topics": _contents(topics, options.all),
        "firings": _time_line(mission.firings),
        "gaps": _gaps(mission),
        "actions": _actions(mission.actions()),
    }
    for what, (heading, rows) in tables.items():
        print("\n".join([*heading, *(rows if options.all else _shortened(rows, what))]), end="\n\n")
    if options.picture is not None:
        from im_pnt_analysis.recorded.plot import plot_mission  # Matplotlib takes a second to come

        plot_mission(mission, options.picture)
        print(f"picture {options.picture}")
    return OK


def _drawing(text: str) -> Path:
    if Path(text).suffix not in (".svg", ".png"):
        raise argparse.ArgumentTypeError(f"{text} ends neither with .svg nor with .png")
    return Path(text)


Table = tuple[list[str], list[str]]
"""Heading and rows."""


def _shortened(rows: list[str], what: str) -> list[str]:
    if len(rows) <= 2 * _ENDS:
        return rows
    return [*rows[:_ENDS], f"... {len(rows) - 2 * _ENDS} {what} more (--all)", *rows[-_ENDS:]]


def _contents(topics: Sequence[Topic], everything: bool) -> Table:
    shown = [topic for topic in topics if everything or topic.count]
    heading = ["CONTENTS", " messages  silence_s  topic and type"]
    if empty := len(topics) - len(shown):
        heading.insert(1, f"{empty} topic{'s' if empty > 1 else ''} without messages (--all)")
    return heading, [f"{topic.count:9d}  {topic.silence_s:9.3f}  {topic.name}  {topic.type}" for topic in shown]


def _time_line(firings: Sequence[RecordedFiring]) -> Table:
    rows = []
    for firing in firings:
        if firing.end_s is None:
            how = "  not ended"
        else:
            how = f"{firing.end_s - firing.begin_s:11.3f}" + ("  FAILED" if firing.failed else "")
        after = f"  after {firing.after}" if firing.after else ""
        rows.append(f"{firing.begin_s:10.3f} {how}  #{firing.command_id} {firing.net}.{firing.transition}{after}")
    return ["TIME LINE", "   begin_s  duration_s  command, net and transition"], rows


def _gaps(mission: Mission) -> Table:
    rows = [f"net {net}: events {first} to {last} were not recorded" for net, first, last in mission.gaps]
    return ["GAPS"], rows or ["none: the events of each net are numbered without a gap"]


def _actions(actions: Sequence[ActionTimes]) -> Table:
    rows = []
    for times in actions:
        expected = "        -" if times.expected_s is None else f"{times.expected_s:9.3f}"
        measured = f"{times.mean_s:9.3f} {times.median_s:9.3f} {times.longest_s:9.3f}"
        rows.append(f"{times.count:6d} {times.failures:6d} {measured} {expected}  {times.net}.{times.transition}")
    return ["ACTIONS", " count failed    mean_s  median_s longest_s expected_s  net and transition"], rows
