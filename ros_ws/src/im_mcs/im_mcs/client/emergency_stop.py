"""Emergency stop on the node's side: power, mark, answer, in order, from any thread."""

import threading

from im_core import clock
from im_core.errors import ImError, StateError
from im_mcs.client.servo_client import ServoClient, ServoReply
from im_mcs.safety.stop_circuits import StopCircuits
from im_mcs.safety.stop_mark import StopLatch
from im_mcs.state import Event
from im_mcs.testbed.driver import PowerReading

#: For how long power, brakes and servo are waited for before the answer says what is so [s], and between two looks [s].
_ANSWER_S, _LOOK_S = 0.2, 0.002


class EmergencyStop:
    """Stop the machine at once, and remember the stop until the reset; without ROS and without a loop.

    Attributes:
        cause: Why the machine is stopped; empty where it is not.
        count: How many stops were asked for.
    """

    def __init__(self, circuits: StopCircuits, latch: StopLatch) -> None:
        self._circuits, self._latch = circuits, latch
        self._lock = threading.Lock()
        self.cause = latch.read()
        self.count = 0

    def stop(self, reason: str, servo: ServoClient | None) -> str:
        """Stop the machine, and describe the state after at most 0.2 s in a sentence.

        The servo is told before its power is cut, so that it names this cause; nothing waits for it.

        Args:
            reason: Cause of the stop; the first one stays.
            servo: The way to the servo; None where there is none.
        """
        self.count += 1
        replies: list[ServoReply] = []
        told = servo is not None and self._tell(servo, reason, replies)
        self._circuits.cut()
        with self._lock:
            said = [self._circuits.cut()]  # once more: a reset that was under way may have restored them
            self.cause = self.cause or reason
            failed = self._latch.keep(reason)
        reading, answered = self._await(servo if told else None, replies)
        said.append(_sentence(reading))
        said += ["the servo has not answered"] * (servo is not None and not answered)
        return "; ".join(filter(None, [*said, failed]))

    def end(self, count: int, *, forget: bool) -> None:
        """Let the machine go on after a reset.

        Args:
            count: :attr:`count` when the reset was asked for.
            forget: Whether to remove the mark; a servo that was reset has done so.

        Raises:
            StateError: Another stop was asked for since.
            StoreError: The mark cannot be removed.
        """
        with self._lock:
            if self.count != count:
                raise StateError("reset was overtaken by another emergency stop", request=Event.RESET.value)
            if forget:
                self._latch.clear()
            self._circuits.restore()
            self.cause = self._latch.read()  # a watch may have stopped the machine anew

    def _tell(self, servo: ServoClient, reason: str, replies: list[ServoReply]) -> bool:
        """Send the stop to the servo; return whether the send succeeded."""
        try:
            servo.send(Event.ESTOP, {"reason": reason}, replies.append)
        except ImError:  # a servo that takes no requests: the circuits do it
            return False
        return True

    def _await(self, servo: ServoClient | None, replies: list[ServoReply]) -> tuple[PowerReading | None, bool]:
        """Wait until nothing is driven, everything is held, and the servo has answered, but not for long."""
        deadline = clock.monotonic() + _ANSWER_S
        while True:
            answered = bool(replies) and replies[0].error is None
            reading = self._circuits.reading()
            if reading is None and servo is not None and answered:  # a driver that the servo alone can ask
                snapshot = servo.snapshot()
                reading = PowerReading(bool(snapshot["power"]), bool(snapshot["brakes"].all()))
            secured = reading is not None and reading.secured
            if (secured and (answered or servo is None)) or clock.monotonic() > deadline:
                return reading, answered
            clock.sleep(_LOOK_S)


def _sentence(reading: PowerReading | None) -> str:
    """Say how power and brakes are."""
    if reading is None:
        return "nobody reports whether the power is off"
    if reading.power:
        return f"power is still on after {_ANSWER_S:g} s"
    return "power is off, " + ("every brake holds" if reading.braked else "not every brake holds yet")
