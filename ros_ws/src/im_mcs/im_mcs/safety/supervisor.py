"""Runs the watches, in a fixed order, in every tick."""

from collections.abc import Sequence

from im_mcs.config import McsConfig
from im_mcs.limits import JointLimits
from im_mcs.safety.motion import FollowingWatch, SpeedWatch
from im_mcs.safety.processes import LeaseWatch, OverrunWatch, OwnerWatch
from im_mcs.safety.slots import AgeWatch, BrakeWatch, PowerWatch, ReadingWatch
from im_mcs.safety.watch import Finding, Reaction, Situation, Watch
from im_mcs.state.reservation import Reservations


class Supervisor:
    """All watches, those that lead to an e-stop first.

    Args:
        watches: In the order in which they are asked.
    """

    def __init__(self, watches: Sequence[Watch]) -> None:
        self._watches = tuple(watches)

    @classmethod
    def make(cls, config: McsConfig, limits: JointLimits, reservations: Reservations) -> "Supervisor":
        """The watches of a configuration."""
        safety, servo = config.safety, config.servo
        return cls(
            (
                PowerWatch(),
                BrakeWatch(limits, servo.period_s, servo.answer_timeout_s, safety.brake_s),
                ReadingWatch(limits),
                SpeedWatch(limits),
                AgeWatch(limits, safety.driver_age_s, safety.driver_age_estop_s),
                FollowingWatch(limits),
                LeaseWatch(reservations),
                OwnerWatch(safety.owner_silence_s),
                OverrunWatch(servo.max_overruns),
            )
        )

    def check(self, now: Situation) -> list[Finding]:
        """What is wrong in this tick; nothing after an e-stop, which takes all with it."""
        findings = []
        for watch in self._watches:
            finding = watch.check(now)
            if finding is not None:
                findings.append(finding)
                if finding.reaction is Reaction.ESTOP:
                    break
        return findings
