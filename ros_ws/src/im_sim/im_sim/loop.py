"""The tick loop of the physics process."""

from im_cell.link import Faults, HostEnd, JawObject, LaserBeam
from im_core import clock
from im_sim.exposures import Exposures
from im_sim.laser import Laser
from im_sim.plant import Plant

SERVO_TIMEOUT_S = 0.5
_DEMAND_WAIT_S = 0.2
_LATE_PERIODS = 10


class TickLoop:
    """Joins plant and link, tick by tick, at the pace of the link's protocol."""

    def __init__(self, plant: Plant, laser: Laser, link: HostEnd) -> None:
        self._plant = plant
        self._laser = laser
        self._link = link
        self._exposures = Exposures(link)
        self._tick = 0
        self._deadline = clock.monotonic()
        self._stopped = False
        self._told_beam: LaserBeam | None = None
        self._publish()

    def stop(self) -> None:
        """End :meth:`run` soon; from any thread."""
        self._stopped = True

    def run(self) -> None:
        """Run until :meth:`stop`."""
        while not self._stopped:
            if self._link.factor == 0.0:
                if not self._plant.settling and not self._link.await_demand(_DEMAND_WAIT_S):
                    continue
            elif not self._link.servo_attached():
                self._pace()
            self.run_tick()

    def run_tick(self) -> None:
        """One tick: the servo's command for the present state, a step of the plant, the next state."""
        plant = self._plant
        if (disturbances := self._link.disturbances()) is not None:
            self._disturb(*disturbances)
        self._link.post_state()
        # While the servo computes, what its command does not change:
        self._exposures.begin_tick(self._tick)
        self._laser.run_tick(self._link.laser_command())
        plant.prepare()
        command = self._link.await_command(SERVO_TIMEOUT_S)
        before = plant.q
        plant.run_tick(command)
        self._tick += 1
        self._publish()
        self._exposures.end_tick(self._tick, before, plant.q, self._laser)

    def _disturb(self, faults: Faults, objects: tuple[JawObject | None, ...]) -> None:
        self._plant.break_(faults)
        self._plant.put(objects)
        for body, pose in self._link.placements():
            self._plant.place(body, pose)
        clock.sleep(self._link.take_stall())

    def _pace(self) -> None:
        """Sleep until the next tick is due; after a pause of the clock, start counting anew."""
        period = self._link.wall_period_s
        self._deadline += period
        now = clock.monotonic()
        if now - self._deadline > _LATE_PERIODS * period:
            self._deadline = now
        clock.sleep_until(self._deadline)

    def _publish(self) -> None:
        plant = self._plant
        if self._laser.beam is not self._told_beam:
            self._told_beam = self._laser.beam
            self._link.publish_laser(self._told_beam)
        self._link.publish_bodies(plant.bodies())
        self._link.publish_state(self._tick, plant.sensors(self._tick), plant.q, plant.v)
