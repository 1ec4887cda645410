"""The physics process's end of the testbed link."""

import numpy as np
from numpy.typing import NDArray

from im_core import clock
from im_core.shm import ProcessId
from im_core.testbed_link.block import LinkBlock
from im_core.testbed_link.values import Command, ExposureRequest

_SLICE_S = 0.05


class HostSide:
    """Publishes states, takes commands and exposure requests, knows whether somebody wants time."""

    _shared: LinkBlock

    def publish_state(
        self,
        tick: int,
        q: NDArray[np.float64],
        power: bool,
        brakes: NDArray[np.bool_],
        gripper: NDArray[np.float64],
        q_true: NDArray[np.float64],
        v_true: NDArray[np.float64],
    ) -> None:
        """Make the state of a tick readable; the first one opens the link for others to attach."""
        view = self._shared.view
        sequence = view["sequence"]
        sequence[()] = int(sequence) + 1
        view["tick"][()] = tick
        view["q"][:] = q
        view["power"][()] = power
        view["brakes"][:] = brakes
        view["gripper"][:] = gripper
        view["q_true"][:] = q_true
        view["v_true"][:] = v_true
        sequence[()] = int(sequence) + 1
        if not self._shared.block.published:
            self._shared.block.publish()

    def servo_attached(self) -> bool:
        """Whether a servo takes part in the handshake."""
        return bool(int(self._shared.view["servo_pid"]))

    def await_command(self, timeout_s: float) -> Command | None:
        """Post the tick to the servo and wait for its command.

        Args:
            timeout_s: After this wall time [s] the servo is declared gone and counted as lost.

        Returns:
            The command; None if there is no servo, or none any more.
        """
        shared, view = self._shared, self._shared.view
        if not self.servo_attached():
            return None
        tick = int(view["tick"])
        servo = ProcessId(int(view["servo_pid"]), int(view["servo_start"]))
        shared.command.drain()
        shared.state.post()
        deadline = 0.0
        while not shared.command.wait(_SLICE_S) or int(view["command_tick"]) != tick:
            deadline = deadline or clock.monotonic() - _SLICE_S + timeout_s
            if int(view["servo_pid"]) != servo.pid:
                return None
            if clock.monotonic() > deadline or not servo.alive():
                self._declare_gone()
                return None
        if int(view["servo_pid"]) != servo.pid:
            return None
        return Command(
            tau=view["command_tau"].copy(),
            power=bool(view["command_power"]),
            brakes=view["command_brakes"].copy(),
            gripper=view["command_gripper"].copy(),
            wants_time=bool(view["command_wants_time"]),
        )

    def demand(self) -> bool:
        """Whether somebody wants another tick at clock factor 0."""
        view = self._shared.view
        if int(view["exposure_request"]) != int(view["exposure_done"]):
            return True
        if int(view["servo_pid"]) and int(view["command_wants_time"]):
            return True
        return int(view["demand_until"].max()) > int(view["tick"])

    def await_demand(self, timeout_s: float) -> bool:
        """Wait until somebody wants a tick, at most ``timeout_s`` [s]; whether somebody does."""
        if self.demand():
            return True
        self._shared.wake.drain()
        return self.demand() or (self._shared.wake.wait(timeout_s) and self.demand())

    def pending_exposure(self) -> ExposureRequest | None:
        """The newest exposure request that was not answered yet."""
        view = self._shared.view
        request = int(view["exposure_request"])
        if request == int(view["exposure_done"]):
            return None
        return ExposureRequest(request, int(view["exposure_ticks"]), bool(view["exposure_blank"]))

    def finish_exposure(
        self,
        request: ExposureRequest,
        start_tick: int,
        end_tick: int,
        q_true: NDArray[np.float64],
        light_fraction: NDArray[np.float64],
    ) -> None:
        """Answer an exposure request."""
        view = self._shared.view
        view["exposure_start"][()] = start_tick
        view["exposure_end"][()] = end_tick
        view["exposure_q"][:] = q_true
        view["exposure_light"][: len(light_fraction)] = light_fraction
        view["exposure_done"][()] = request.request
        self._shared.exposed.post()

    def _declare_gone(self) -> None:
        view = self._shared.view
        view["servo_pid"][()] = 0
        view["command_wants_time"][()] = False
        view["servo_losses"][()] = int(view["servo_losses"]) + 1
