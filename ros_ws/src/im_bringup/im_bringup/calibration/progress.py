"""The firings of a command's net as lines for the terminal: one for each pose of the loop, one for each other step."""

from enum import IntEnum


class FiringPhase(IntEnum):
    """Phase of a firing, as in ``im_msgs/msg/Firing``."""

    START = 0
    END = 1
    FAILED = 2
    CANCEL = 3
    DOUBT = 4


#: The net ``calibrate_camera``: what takes the next pose, what ends one, and what needs no line of its own.
FIRST = "read_next_pos"
LAST = frozenset({"loop_again", "loop_done", "skip_unreached", "skip_unseen", "skip_unusable", "note_failure"})
ABORTS = "abort_"
QUIET = frozenset({"skip_again", "skip_done"})


class ProgressLines:
    """Turns firings of the net ``calibrate_camera`` into lines; the steps of a pose are told together."""

    def __init__(self) -> None:
        self._pose = self._total = 0
        self._steps: list[str] | None = None

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
        if self._steps is None:
            return _told(fraction, step) if phase is FiringPhase.FAILED else None
        if (transition in LAST and phase is FiringPhase.END) or transition.startswith(ABORTS):
            if transition in LAST and fraction > 0.0:  # an aborted pose is not part of the fraction
                self._total = round(self._pose / fraction)
            line = self._pose_line(fraction)
            self._steps = None
            return line
        if transition != FIRST:
            self._steps.append(step)
        return None

    def _begun(self, transition: str, fraction: float) -> str | None:
        if transition == FIRST:
            self._pose, self._steps = self._pose + 1, []
            return None
        if self._steps is not None or transition in LAST | QUIET:
            return None
        return _told(fraction, transition)

    def _pose_line(self, fraction: float) -> str:
        total = f" of {self._total}" if self._total else ""
        return _told(fraction, f"pose {self._pose}{total}: {', '.join(self._steps or [])}")


def _told(fraction: float, text: str) -> str:
    share = f"[{100 * fraction:3.0f} %]" if fraction >= 0 else "[  - %]"
    return f"{share} {text}"
