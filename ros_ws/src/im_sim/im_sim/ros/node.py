"""Node ``/testbed``: owns the physics process, publishes ``/clock``, switches the wrist lights."""

import json
import math
import sys
from collections.abc import Callable
from typing import Any, TypeVar

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

from im_cell.link import PanelEnd
from im_cell.robot import load_cell
from im_cell.robot.truth import FILE_NAME, CellTruth
from im_core import clock, names
from im_core.errors import ConfigError, DataError, ImError, LinkError, StateError
from im_core.files import write_whole
from im_core.processes.process import ChildProcess
from im_core.processes.startup import patience_s
from im_core.ros import qos
from im_core.ros import run as ros_run
from im_core.ros.calls import run_in_thread
from im_core.ros.messages.stamps import to_stamp
from im_core.ros.node import ManagedNode
from im_core.shm_names import remove_all
from im_msgs.srv import Advance, GetTruth, InjectFault, PlaceObject, PutInJaws, SetLight
from im_sim.panel import FaultPanel, Lights
from im_sim.truth import draw_truth

#: How often ``/clock`` follows the testbed, and how often it is looked at while time stands still for longer [s].
CLOCK_POLL_S, STANDING_POLL_S, STANDING_S = 0.01, 0.05, 1.0
CLOCK_REPEAT_S = 1.0
DIAGNOSTICS_PERIOD_S = 1.0
LONGEST_ADVANCE_S = 3600.0

_Answer = TypeVar("_Answer", InjectFault.Response, PlaceObject.Response, PutInJaws.Response)


class TestbedNode(ManagedNode):
    """ROS shell of the simulated testbed."""

    __test__ = False  # not a test class

    def __init__(self) -> None:
        super().__init__("testbed")
        self._child: ChildProcess | None = None
        self._link: PanelEnd | None = None
        self._truth: CellTruth | None = None
        self._published_tick, self._published_at, self._ticked_at = -1, 0.0, 0.0
        self._last_diagnosed = (0, clock.monotonic())
        declare = self.declared.declare
        fast = "simulated seconds a second of wall time; 0: as fast as it goes"
        self._factor = declare("factor", 1.0, fast, span=(0.0, math.inf))
        self._seed = declare("seed", 0, "of everything that is drawn at random", span=(0, 2**31 - 1))
        told = "whether arms are as drawn, not off by 0.3 to 1 mm"
        self._perfect_arm = declare("perfect_arm", False, told)
        self._period = declare("period", 0.0, "of a tick of the testbed [s]; 0: the cell's", span=(0.0, 0.1))
        self._clock_publisher = self.create_publisher(Clock, "/clock", qos.CLOCK)
        self._lights_publisher = self.create_publisher(String, "/testbed/lights", qos.LATCHED)
        self._diagnostics_publisher = self.create_publisher(DiagnosticArray, "/diagnostics", qos.STATUS)
        self.create_service(SetLight, "/testbed/set_light", self._set_light)
        self.create_service(GetTruth, "/testbed/get_truth", self._get_truth)
        self.create_service(Advance, "/testbed/advance", self._advance)
        self.create_service(InjectFault, "/testbed/inject_fault", self._inject_fault)
        self.create_service(PutInJaws, "/testbed/put_in_jaws", self._put_in_jaws)
        self.create_service(PlaceObject, "/testbed/place_object", self._place_object)

    def phase_configure(self) -> None:
        """Draw the truth, start the physics process and attach to the link."""
        self._cell = load_cell()
        if self._period != 0.0:
            self._cell = self._cell.at_period(self._period)
        self._truth = draw_truth(self._cell, self._seed, perfect_arm=self._perfect_arm)
        run_dir = names.run_dir()
        write_whole(run_dir / FILE_NAME, self._truth.model_dump_json(indent=1))
        arguments = ["--instance", names.instance(), "--factor", repr(self._factor)]
        arguments += ["--seed", str(self._seed), "--truth", str(run_dir / FILE_NAME)]
        arguments += ["--period", repr(self._cell.period)]
        self._child = ChildProcess.of_module("im_sim.physics", arguments, log=run_dir / "physics.log")
        self._link = self._attach(self._child)

    def phase_start(self) -> None:
        """Publish clock, lights and diagnostics."""
        self._publish_lights()
        self._poll_timer = self.create_timer(CLOCK_POLL_S, self._follow_physics, clock=self.steady_clock)
        self.create_timer(DIAGNOSTICS_PERIOD_S, self._publish_diagnostics, clock=self.steady_clock)

    def phase_shutdown(self) -> None:
        """End the physics process; nothing of the process stays in shared memory."""
        link, self._link = self._link, None
        if link is not None:
            link.close()
        if self._child is not None:
            self._child.stop()
            remove_all(f"{names.instance()}_testbed")

    def _attach(self, child: ChildProcess) -> PanelEnd:
        deadline = clock.monotonic() + patience_s()
        while True:
            try:
                return PanelEnd.attach(names.instance(), timeout_s=0.1)
            except LinkError:
                child.check()
                if clock.monotonic() > deadline:
                    raise

    def _running(self) -> PanelEnd:
        if self._link is None:
            raise StateError("the testbed is not configured yet" if not self.failed else self.failed)
        if self.failed:
            raise StateError(f"the testbed has failed: {self.failed}")
        return self._link

    def _follow_physics(self) -> None:
        if self._link is None or self._child is None or self.failed:
            return
        try:
            self._child.check()
        except LinkError as error:
            self.fail(error)
            return
        tick, now = self._link.tick, clock.monotonic()
        ticked = tick != self._published_tick
        if ticked or now - self._published_at > CLOCK_REPEAT_S:
            self._published_tick, self._published_at = tick, now
            self._clock_publisher.publish(Clock(clock=to_stamp(tick * self._link.period_ns)))
        self._ticked_at = now if ticked else self._ticked_at
        self._poll_every(CLOCK_POLL_S if now - self._ticked_at < STANDING_S else STANDING_POLL_S)

    def _poll_every(self, period_s: float) -> None:
        period_ns = round(period_s * 1e9)
        if self._poll_timer.timer_period_ns != period_ns:
            self._poll_timer.timer_period_ns = period_ns

    def _publish_lights(self) -> None:
        if self._link is not None:
            self._lights_publisher.publish(String(data=json.dumps(Lights(self._link).state())))

    def _publish_diagnostics(self) -> None:
        if self._link is None:
            return
        tick, now = self._link.tick, clock.monotonic()
        last_tick, last_now = self._last_diagnosed
        self._last_diagnosed = (tick, now)
        speed = (tick - last_tick) * self._link.period_s / max(now - last_now, 1e-9)
        values = {
            "tick": tick,
            "testbed time [s]": f"{tick * self._link.period_s:.4f}",
            "clock factor": self._link.factor,
            "speed [testbed s / s]": f"{speed:.3f}",
            "servo process": self._link.servo_pid or "none",
            "servos lost": self._link.servo_losses,
        }
        status = DiagnosticStatus(
            level=DiagnosticStatus.ERROR if self.failed else DiagnosticStatus.OK,
            name="testbed: physics",
            message=self.failed or "running",
            hardware_id="simulated testbed",
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = to_stamp(tick * self._link.period_ns)
        self._diagnostics_publisher.publish(message)

    def _set_light(self, request: SetLight.Request, response: SetLight.Response) -> SetLight.Response:
        try:
            Lights(self._running()).switch(request.name, request.on)
        except ImError as error:
            response.message = error.message
            return response
        self._publish_lights()
        response.success = True
        response.message = f"{request.name} is {'on' if request.on else 'off'}"
        return response

    def _get_truth(self, _: GetTruth.Request, response: GetTruth.Response) -> GetTruth.Response:
        if self._truth is None:
            response.message = "the testbed is not configured yet"
            return response
        response.success = True
        bodies = {} if self._link is None else FaultPanel(self._cell, self._link).bodies()
        response.json = self._truth.model_copy(update={"objects": bodies}).model_dump_json()
        return response

    def _inject_fault(self, request: InjectFault.Request, response: InjectFault.Response) -> InjectFault.Response:
        return self._at_panel(
            response, lambda panel: panel.inject(request.fault, request.joint, request.active, request.duration)
        )

    def _put_in_jaws(self, request: PutInJaws.Request, response: PutInJaws.Response) -> PutInJaws.Response:
        return self._at_panel(
            response,
            lambda panel: panel.put_in_jaws(request.gripper, request.width, request.stiffness, request.mass),
        )

    def _place_object(self, request: PlaceObject.Request, response: PlaceObject.Response) -> PlaceObject.Response:
        p, o = request.pose.position, request.pose.orientation
        pose = (p.x, p.y, p.z, o.x, o.y, o.z, o.w)
        return self._at_panel(response, lambda panel: panel.place(request.name, pose))

    def _at_panel(self, response: _Answer, act: Callable[[FaultPanel], str]) -> _Answer:
        try:
            response.message = act(FaultPanel(self._cell, self._running()))
        except ImError as error:
            response.message = error.message
            return response
        response.success = True
        return response

    async def _advance(self, request: Advance.Request, response: Advance.Response) -> Advance.Response:
        try:
            link = self._running()
            duration = _number(request.duration, "duration", lowest=0.0, highest=LONGEST_ADVANCE_S)
            ticks = math.ceil(round(duration / link.period_s, 6))
            until = link.request_time(ticks)
            slowest = min(link.factor, 0.5) or 0.5
            tick = await run_in_thread(self, link.wait_tick, until, 10.0 + duration / slowest)
        except ImError as error:
            response.message = error.message
            return response
        response.success = True
        response.message = f"{ticks} ticks have passed"
        response.stamp = to_stamp(tick * link.period_ns)
        return response


def _number(value: Any, name: str, lowest: float, highest: float = math.inf) -> float:
    """Return a number within bounds.

    Raises:
        ConfigError: It is not one.
        DataError: It is out of bounds.
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ConfigError(f"parameter {name} of /testbed is {value!r}, not a number", parameter=name)
    if not lowest <= value <= highest:
        raise DataError(f"{name} {value} of /testbed is not between {lowest:g} and {highest:g}", name=name, value=value)
    return value


def main() -> int:
    """Entry point of the executable ``testbed``."""
    return ros_run.main(TestbedNode)


if __name__ == "__main__":
    sys.exit(main())
