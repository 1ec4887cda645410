"""The firings of a command's net as lines for the terminal: one for each pose of the loop, one for each other step."""

from dataclasses import dataclass, field
from enum import IntEnum


class FiringPhase(IntEnum):
    """Phase of a firing, as in ``im_msgs/msg/Firing``."""

    START = 0
    END = 1
    FAILED = 2
    CANCEL = 3
    DOUBT = 4


#: The net ``calibrate_camera``: what takes the next pose, what is done for the one that the arm has left, what ends a
#: pose, and what needs no line of its own.
FIRST = frozenset({"read_first_pos", "read_planned_pos", "read_next_pos"})
BEHIND = frozenset({"find_spot", "keep_observation"})
LAST = frozenset({"keep_observation", "visit_again", "skip_unreached", "skip_unseen", "skip_unusable", "note_failure"})
ABORTS = "abort_"
QUIET = frozenset(
    {
        "begin_pose",
        "end_ahead",
        "stay",
        "stay_cancelled",
        "loop_again",
        "loop_done",
        "skip_again",
        "skip_done",
    }
)


@dataclass
class _Pose:
    number: int
    steps: list[str] = field(default_factory=list)


class ProgressLines:
    """Turns firings of the net ``calibrate_camera`` into lines; the steps of a pose are told together."""

    def __init__(self) -> None:
        self._last = self._total = 0
        self._poses: list[_Pose] = []
        """Those that have not ended: the one that the arm has left, before the one where it is."""

    def line(self, transition: str, phase: FiringPhase, message: str, fraction: float, duration_s: float) -> str | None:
        """The line that a firing completes, or None.

        Args:
            transition: What fired.
            phase: What happened to it.
            message: Reason of a failure or a doubt.
            fraction: Progress of the command 0..1, negative where unknown.
            duration_s: Wall time between start and end [s].
        """
        if phase is FiringPhase.START:
            return self._begun(transition, fraction)
        if phase is FiringPhase.CANCEL:
            return None
        if phase is FiringPhase.DOUBT:
            return _told(fraction, f"{transition} is in doubt: {message}")
        step = f"{transition} failed: {message}" if phase is FiringPhase.FAILED else f"{transition} {duration_s:.2f} s"
        if not self._poses:
            return _told(fraction, step) if phase is FiringPhase.FAILED else None
        if (phase is FiringPhase.END and transition in LAST | QUIET) or transition.startswith(ABORTS):
            return self._ended(transition, fraction)
        if transition in FIRST and phase is FiringPhase.FAILED:  # that pose is not begun
            self._last -= 1
            self._poses.pop()
            if not self._poses:
                return _told(fraction, step)
        if transition not in FIRST or phase is FiringPhase.FAILED:
            self._poses[0 if transition in BEHIND else -1].steps.append(step)
        return None

    def _begun(self, transition: str, fraction: float) -> str | None:
        if transition in FIRST:
            self._last += 1
            self._poses.append(_Pose(self._last))
            return None
        if self._poses or transition in LAST | QUIET:
            return None
        return _told(fraction, transition)

    def _ended(self, transition: str, fraction: float) -> str | None:
        if transition in QUIET:
            return None
        pose = self._poses.pop(0)
        if transition in LAST and fraction > 0.0:  # an aborted pose is not part of the fraction
            self._total = self._total or round(pose.number / fraction)
        total = f" of {self._total}" if self._total else ""
        return _told(fraction, f"pose {pose.number}{total}: {', '.join(pose.steps)}")


def _told(fraction: float, text: str) -> str:
    share = f"[{100 * fraction:3.0f} %]" if fraction >= 0 else "[  - %]"
    return f"{share} {text}"
