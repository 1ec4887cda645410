"""Times of a robot's readings, from the stamps of messages on the robot's clock."""

import math

_SPAN_S = 0.25
# largest difference between the paces of two clocks, as a share
_PACE = 0.05


class StampClock:
    """Estimator of the times of readings, for messages with delays.

    Of the last moments, the message that came soonest after its stamp counts as not late (E. Olson, "A passive solution
    to the sensor synchronization problem", IROS 2010). Each other message is as late as its delay is longer. A
    reading whose stamp says nothing counts from its receipt: the stamp is 0, not later than the one before, or of a
    clock that goes at another pace, as simulated time may. So do the readings of the first quarter to half a second.
    """

    def __init__(self) -> None:
        self._stamp_s = self._taken_s = -math.inf
        self._before_s = self._least_s = math.inf
        self._since_s, self._keeps_pace = 0.0, False

    def taken_s(self, stamp_s: float, received_s: float) -> float:
        """Return the time of a reading on the clock of the receipt, never before an earlier reading [s].

        Args:
            stamp_s: Stamp of its message, on the robot's clock [s].
            received_s: When the message was received [s].
        """
        delay_s, span_s = received_s - stamp_s, received_s - self._since_s
        if not self._stamp_s < stamp_s:
            self._before_s = self._least_s = math.inf
            self._since_s, self._keeps_pace = received_s, False
        elif span_s > _SPAN_S:
            self._keeps_pace = abs(self._least_s - self._before_s) <= _PACE * span_s
            self._before_s, self._least_s, self._since_s = self._least_s, math.inf, received_s
        self._stamp_s, self._least_s = stamp_s, min(self._least_s, delay_s)
        late_s = delay_s - min(self._before_s, self._least_s) if self._keeps_pace else 0.0
        self._taken_s = max(self._taken_s, received_s - late_s)
        return self._taken_s
