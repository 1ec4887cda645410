"""Answers of the servo: replies, results of goals with the evidence, progress."""

import math
from collections.abc import Callable, Mapping
from typing import Any

from im_core.errors import ImError
from im_mcs.group import ControlledGroup
from im_mcs.group.goals import Goal
from im_mcs.protocol.evidence import Recorder

Emit = Callable[[dict[str, Any]], None]
_PROGRESS_S = 0.1


class Answers:
    """Sender of answers to the authors of requests.

    Args:
        emit: Takes messages.
        recorder: Keeps the evidence of what was aborted.
        period_s: Servo period [s].
    """

    def __init__(self, emit: Emit, recorder: Recorder, period_s: float) -> None:
        self._emit = emit
        self._recorder = recorder
        self._period_s = period_s
        self._progress_ticks = max(1, round(_PROGRESS_S / period_s))

    def reply(self, number: int, error: ImError | None, results: Mapping[str, object] | None = None) -> None:
        """Answer a request."""
        message: dict[str, Any] = {"event": "reply", "id": number, "success": error is None, "results": results or {}}
        if error is not None:
            message["error"] = {"code": error.code, "message": error.message, "facts": _plain(error.facts)}
        self._emit(message)

    def accuse(self, fault: ImError) -> None:
        """Keep the last seconds as evidence of a fault; the facts name the record."""
        fault.facts.setdefault("evidence", self._recorder.freeze())

    def end_goal(self, goal: Goal, fault: ImError | None, results: Mapping[str, Any]) -> None:
        """Send the result of a goal; an abort of a motion names the evidence."""
        told = dict(results)
        if fault is not None and fault.code not in ("cancelled", "replaced"):
            if "evidence" not in fault.facts and told.get("duration", 0.0) > 0.0:
                self.accuse(fault)
            if "evidence" in fault.facts:
                told["evidence"] = fault.facts["evidence"]
        self.reply(goal.id, fault, told)

    def drop_goal(self, goal: Goal, fault: ImError, tick: int) -> None:
        """Report the immediate end of a goal."""
        self.end_goal(goal, fault, {"duration": (tick - goal.since_tick) * self._period_s})

    def tell_progress(self, group: ControlledGroup, tick: int) -> None:
        """Tell the progress of a group's goal, now and then."""
        if tick % self._progress_ticks == 0 and (progress := group.progress()) is not None:
            self._emit({"event": "progress", **progress})


def _plain(facts: Mapping[str, object]) -> dict[str, object]:
    """Return facts as JSON data, without infinities; unknown values of drivers and laws become texts."""
    return {name: value if _travels(value) else str(value) for name, value in facts.items()}


def _travels(value: object) -> bool:
    if isinstance(value, list | tuple):
        return all(map(_travels, value))
    return math.isfinite(value) if isinstance(value, float) else isinstance(value, str | int | None)
