"""A recording as shown by the page: the nets at any moment, the next firings, and the time line of actions."""

import math
from collections.abc import Iterator, Mapping, Sequence

from im_core.errors import DataError
from im_pnt.execution.notification import Firing
from im_pnt.model.expand import active_place, cancelling_place, doubt_place
from im_pnt_analysis.recorded.timeline import Described, Moment, NetRecording, NetState
from im_pnt_display.page.messages import firing_content
from im_pnt_display.page.recorded_cell import RecordedCell
from im_pnt_display.page.state import FIRINGS_KEPT, Change, net_content

#: So many firings come with a moment: those that follow it.
FIRINGS_AHEAD = 200


class RecordedNets:
    """Nets of a recording; each viewer asks for a moment independently.

    Args:
        name: What the recording is called.
        recording: The recording.
        cell: The cell in it; None: it is not shown.

    Attributes:
        overview: What a viewer needs to know of the whole, as JSON data: ``name``; ``firings`` and ``end``, their
            number and the time of the last moment [s]; whether there is a ``cell``; ``drawings``, the descriptions of
            all nets; ``rows`` and ``bars``, the time line (row, begin [s], end [s] or None, whether it failed,
            command); ``gaps``.
    """

    def __init__(self, name: str, recording: NetRecording, cell: RecordedCell | None = None) -> None:
        self._recording, self._cell = recording, cell
        mission = recording.mission
        lasting = [firing for firing in mission.firings if firing.on_time_line]
        rows = {label: row for row, label in enumerate(dict.fromkeys(f"{f.net}.{f.transition}" for f in lasting))}
        self.overview: Mapping[str, object] = {
            "name": name,
            "firings": recording.firings,
            "end": recording.moments[-1].at_s,
            "cell": cell is not None and cell.recorded,
            "drawings": [{"node": told.node, **net_content(told.net)} for told in recording.descriptions],
            "rows": list(rows),
            "bars": [[rows[f"{f.net}.{f.transition}"], f.begin_s, f.end_s, f.failed, f.command_id] for f in lasting],
            "gaps": [f"net {net}: events {first} to {last} were not recorded" for net, first, last in mission.gaps],
        }

    def moment(self, asked: Mapping[str, str]) -> Change:
        """Return the nets at a moment, and the next firings.

        Args:
            asked: Which: ``at``, a time [s], or ``firing``, the number of the firing that has just happened.

        Raises:
            DataError: There is no such moment.
        """
        recording = self._recording
        match dict(asked):
            case {"at": text}:
                at_s = _time(text)
                position = recording.position_at(at_s)
            case {"firing": text}:
                position = recording.position_of(_number(text))
                at_s = recording.moments[position - 1].at_s if position else 0.0
            case _:
                raise DataError("give the moment as 'at', a time in seconds, or as 'firing', the number of a firing")
        states, firing = recording.states(position), recording.firings_until(position)
        until = recording.position_of(min(firing + FIRINGS_AHEAD, recording.firings))
        if firing + FIRINGS_AHEAD >= recording.firings:
            until = len(recording.moments)
        return {
            "kind": "moment",
            "at": at_s,
            "firing": firing,
            "nets": sorted(state.description for state in states.values() if state.description is not None),
            "markings": [self._marking(state) for state in states.values()],
            "firings": [_firing(*each) for each in recording.firings_before(position, FIRINGS_KEPT)],
            "steps": list(self._steps(states, recording.moments[position:until], firing)),
            "more": until < len(recording.moments),
        }

    def cell(self, asked: Mapping[str, str]) -> list[Change]:
        """Return the changes of the cell at a time.

        Args:
            asked: ``at``, the time [s], and ``since``, the time at which the viewer knows the cell; empty: at none.

        Raises:
            DataError: They are no times, or the bag cannot be read.
        """
        since = asked.get("since", "")
        at_s, since_s = _time(asked.get("at", "")), _time(since) if since else None
        return self._cell.parts(at_s, since_s) if self._cell is not None else []

    def _steps(self, states: dict[str, NetState], moments: Sequence[Moment], firing: int) -> Iterator[Change]:
        """Return the changes at some moments, with the states."""
        for moment in moments:
            event = moment.event
            known = event.net in states
            self._recording.advance(states, moment)
            state = states[event.net]
            changes: list[Change] = []
            if isinstance(event, Described) and event.description is None:
                yield {"at": moment.at_s, "firing": firing, "changes": [{"kind": "gone", "net": event.net}]}
                continue
            if state.description is not None and (isinstance(event, Described) or not known):
                changes.append({"kind": "drawing", "drawing": state.description})
            if isinstance(event, Firing):
                firing += 1
                changes.append(_firing(moment.at_s, event))
            changes.append(self._marking(state))
            yield {"at": moment.at_s, "firing": firing, "changes": changes}

    def _marking(self, state: NetState) -> Change:
        marking, number = state.marking, state.description
        acting = []
        if number is not None:
            net = self._recording.descriptions[number].net
            acting = [name for name, transition in net.transitions.items() if transition.action is not None]
        cancelling = [name for name in acting if cancelling_place(name) in marking.tokens]
        in_doubt = [name for name in acting if doubt_place(name) in marking.tokens]
        lit = {*cancelling, *in_doubt}
        return {
            "kind": "marking",
            "net": marking.net,
            "tokens": marking.tokens,
            "active": [name for name in acting if name in lit or active_place(name) in marking.tokens],
            "cancelling": cancelling,
            "in_doubt": in_doubt,
            "sequence": marking.sequence,
            "mode": marking.mode,
            "paused": marking.paused,
            "proposed": marking.proposed,
        }


def _firing(at_s: float, firing: Firing) -> Change:
    return {"kind": "firing", **firing_content(at_s, firing)}


def _time(text: str) -> float:
    try:
        at_s = float(text)
    except ValueError:
        at_s = math.nan
    if not math.isfinite(at_s):
        raise DataError(f"{text[:60]!r} is no time in seconds")
    return at_s


def _number(text: str) -> int:
    if not (text.isascii() and text.isdecimal() and len(text) < 16):
        raise DataError(f"{text[:60]!r} is no number of a firing")
    return int(text)
