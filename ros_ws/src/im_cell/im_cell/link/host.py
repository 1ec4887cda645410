"""The physics process's end of the testbed link."""

from typing import Self

import numpy as np
from numpy.typing import NDArray

from im_cell.link.block import MAX_LIGHTS, LinkBlock, objects_of
from im_cell.link.end import LinkEnd, TimeSlot
from im_cell.link.values import (
    ControlState,
    Drive,
    ExposureRequest,
    Faults,
    JawObject,
    LaserBeam,
    Sensors,
    TrueState,
)
from im_core import clock
from im_core.errors import DataError
from im_core.patience import Silence
from im_core.processes.procfs import ProcessId

DEFAULT_LIGHTS = ("left_led", "right_led")
#: How long time waits for an image that is due, at clock factor 0 [s]: less than a servo waits for a tick.
IMAGE_PATIENCE_S = 1.0
_SLICE_S = 0.05
#: Share of the usual time for which a servo is waited for while the emergency stop circuit is cut.
_CUT_SHARE = 0.1


class HostEnd(LinkEnd):
    """Publishes states, takes commands and exposure requests, knows the truth and whether somebody wants time.

    The process that simulates creates it; who judges the machine (benches, tests) may attach one to read the truth.
    """

    _seen = 0
    _placed: NDArray[np.int64] | None = None
    _asked = 0
    _image_due, _image_due_at = 0, 0.0
    _laser_numbers, _laser_command = b"", LaserBeam()

    @classmethod
    def create(
        cls,
        instance: str,
        n_joints: int = 18,
        period_s: float = 0.0045,
        factor: float = 1.0,
        seed: int = 0,
        light_names: tuple[str, ...] = DEFAULT_LIGHTS,
        n_grippers: int = 2,
        n_wrenches: int = 2,
    ) -> Self:
        """Create the link; remains of a dead machine are replaced.

        Others can attach once the first state is published.

        Raises:
            DataError: Period, factor or number of lights is out of range.
            LinkError: A living process of the same instance owns the link.
        """
        if period_s <= 0.0:
            raise DataError(f"testbed period {period_s} s is not > 0", period=period_s)
        if factor < 0.0:
            raise DataError(f"clock factor {factor} is not >= 0", factor=factor)
        if len(light_names) > MAX_LIGHTS:
            raise DataError(f"{len(light_names)} lights are more than {MAX_LIGHTS}", lights=len(light_names))
        counts = (n_joints, n_grippers, n_wrenches)
        return cls(LinkBlock.create(instance, counts, round(period_s * 1e9), factor, seed, light_names))

    def publish_state(
        self, tick: int, sensors: Sensors, q_true: NDArray[np.float64], v_true: NDArray[np.float64]
    ) -> None:
        """Make the state of a tick readable; the first one opens the link for others to attach."""
        view = self._shared.view
        sequence = view["sequence"]
        sequence[()] = int(sequence) + 1
        view["tick"][()] = tick
        self._shared.sensed.put(sensors)
        self._shared.true.put((q_true, v_true))
        sequence[()] = int(sequence) + 1
        if not self._shared.block.published:
            self._shared.block.publish()

    def read_truth(self) -> TrueState:
        """True joint state."""
        return TrueState(*self._shared.true.get())

    def servo_attached(self) -> bool:
        """Whether a servo takes part in the handshake."""
        return bool(int(self._shared.view["servo_pid"]))

    def read_control(self) -> ControlState:
        """Read the control state of the motors: controlling servo, and ability of the motors to move."""
        view = self._shared.view
        return ControlState(
            tick=self.tick,
            servo=int(view["servo_pid"]),
            losses=int(view["servo_losses"]),
            power=bool(view["power"]),
            braked=bool(view["brakes"].all()),
        )

    def post_state(self) -> None:
        """Let the servo, if there is one, begin to answer the state published last."""
        shared = self._shared
        self._asked = int(shared.view["servo_pid"])
        if self._asked:
            shared.command.drain()
            shared.state.post()

    def await_command(self, timeout_s: float) -> Drive | None:
        """Wait for the servo's command to the state posted last.

        Args:
            timeout_s: After this time [s], in which it had a processor or wanted none, the servo is declared gone and
                counted as lost; after a tenth of it while the emergency stop circuit is cut.

        Returns:
            The command, without power while the emergency stop circuit is cut; None if there is no servo, or none any
            more.
        """
        shared, view = self._shared, self._shared.view
        tick, pid = int(view["tick"]), self._asked
        if not pid:
            return None
        silence: Silence | None = None
        while not shared.command.wait(_SLICE_S) or int(view["command_tick"]) != tick:
            silence = silence or Silence(pid, longest_look_s=2.0 * _SLICE_S)
            if int(view["servo_pid"]) != pid:
                return None
            patience_s = timeout_s * (_CUT_SHARE if bool(view["stop"]) else 1.0)
            if silence.look() > patience_s or not ProcessId(pid, int(view["servo_start"])).alive():
                self._declare_gone()
                return None
        if int(view["servo_pid"]) != pid:
            return None
        tau, power, brakes, gripper, wants_time, force = shared.commanded.get()
        return Drive(tau, bool(power) and not bool(view["stop"]), brakes, gripper, bool(wants_time), force)

    def disturbances(self) -> tuple[Faults, tuple[JawObject | None, ...]] | None:
        """Return faults and objects between the jaws of each gripper, if changed since the last return.

        None otherwise, and while they are being written; then they are there at a later call.
        """
        count = self._shared.view["disturbances"]
        changes = int(count)
        if changes == self._seen or changes % 2:
            return None
        faults, objects = self._shared.faults(), self._shared.view["objects"].tolist()
        placements, poses = self._shared.view["placements"].copy(), self._shared.view["placed"].copy()
        if int(count) != changes:
            return None
        self._seen, self._poses, self._placements = changes, poses, placements
        return faults, objects_of(objects)

    def placements(self) -> list[tuple[int, NDArray[np.float64]]]:
        """Return free bodies placed between the last two returns of disturbances: rank and pose, shape (7,)."""
        before = np.zeros_like(self._placements) if self._placed is None else self._placed
        self._placed = self._placements
        return [(int(rank), self._poses[rank]) for rank in np.flatnonzero(self._placements != before)]

    def publish_bodies(self, poses: NDArray[np.float64]) -> None:
        """Publish where the free bodies are: position [m] and quaternion x, y, z, w of each, shape (m, 7)."""
        if len(poses):
            self._shared.view["bodies"][: len(poses)] = poses

    def lights(self) -> tuple[bool, ...]:
        """Which lights are switched on, in the order of ``light_names``."""
        return self._shared.lights()

    def take_stall(self) -> float:
        """How long physics shall pause now, wall time [s]; each stall is taken once."""
        stall = self._shared.view["stall_s"]
        seconds = float(stall)
        stall[()] = 0.0
        return seconds

    def laser_command(self) -> LaserBeam:
        """Return the commanded state of the laser scanner; the same object until the next state."""
        command = self._shared.view["laser_command"]
        if (numbers := command.tobytes()) != self._laser_numbers:
            self._laser_numbers, self._laser_command = numbers, LaserBeam(*np.frombuffer(numbers).tolist())
        return self._laser_command

    def publish_laser(self, beam: LaserBeam) -> None:
        """Publish the readings of the laser scanner's own sensors."""
        self._shared.view["laser"][:] = beam.values()

    def demand(self) -> bool:
        """Return whether a client wants another tick at clock factor 0, and no due image is awaited.

        Whoever takes it has the time that it takes: exposures, and what is asked for in the slot of vision.
        """
        view = self._shared.view
        wanted = (int(view["command_wants_time"]) and int(view["servo_pid"])) or self.time_asked()
        if wanted and not self._image_awaited():
            return True
        exposed = int(view["exposure_request"]) != int(view["exposure_done"])
        return exposed or int(view["demand_until"][TimeSlot.VSS]) > self.tick

    def await_demand(self, timeout_s: float) -> bool:
        """Wait until somebody wants a tick, at most ``timeout_s`` [s]; whether somebody does."""
        if self.demand():
            return True
        self._shared.wake.drain()
        return self.demand() or (self._shared.wake.wait(timeout_s) and self.demand())

    def pending_exposure(self) -> ExposureRequest | None:
        """Return the newest exposure request without an answer."""
        view = self._shared.view
        request = int(view["exposure_request"])
        if request == int(view["exposure_done"]):
            return None
        blank = bool(view["exposure_blank"]), bool(view["exposure_blank_laser"])
        return ExposureRequest(request, int(view["exposure_ticks"]), *blank)

    def finish_exposure(
        self,
        request: ExposureRequest,
        start_tick: int,
        end_tick: int,
        q_true: NDArray[np.float64],
        light_fraction: NDArray[np.float64],
        laser: LaserBeam,
    ) -> None:
        """Answer an exposure request; free bodies and jaws are shown as at its end."""
        view = self._shared.view
        view["exposure_start"][()] = start_tick
        view["exposure_end"][()] = end_tick
        view["exposure_q"][:] = q_true
        view["exposure_light"][: len(light_fraction)] = light_fraction
        view["exposure_laser"][:] = laser.values()
        view["exposure_bodies"][:] = view["bodies"]
        view["exposure_jaws"][:] = view["gripper"]
        view["exposure_done"][()] = request.request
        self._shared.exposed.post()

    def _image_awaited(self) -> bool:
        """Return whether a due image was not yet reported; an image awaited in vain is not waited for again."""
        due = int(self._shared.view["image_due"])
        if not 0 < due <= self.tick:
            return False
        if due != self._image_due:
            self._image_due, self._image_due_at = due, clock.monotonic()
        return clock.monotonic() - self._image_due_at < IMAGE_PATIENCE_S

    def _declare_gone(self) -> None:
        view = self._shared.view
        view["servo_pid"][()] = 0
        view["command_wants_time"][()] = False
        view["servo_losses"][()] = int(view["servo_losses"]) + 1
