"""The cameras' controls as ROS parameters, and images at the rates."""

from collections.abc import Callable

from rclpy.parameter import Parameter
from rclpy.timer import Timer

from im_cell.sensor import SensorControls
from im_core.errors import ImError
from im_core.ros.calls import run_in_thread
from im_core.ros.node import ManagedNode
from im_vss.image_rate import Rhythm
from im_vss.rig import CameraControls
from im_vss.settings import VssSettings

POLL_S = 0.01
"""Wall time between two looks at the clock, as often as ``/clock`` is published."""


class ImageStream:
    """Take images at the rate of :class:`im_vss.image_rate.Rhythm`, by the clock of the node."""

    def __init__(
        self, node: ManagedNode, take: Callable[[tuple[str, ...]], int], await_image: Callable[[int | None], None]
    ) -> None:
        """Nothing flows yet.

        Args:
            node: The node whose loop it runs in.
            take: Takes an image with each of some cameras at the same time, in a thread; when the exposure ended,
                testbed time [ns].
            await_image: Is told when the next image is due, testbed time [ns]; None: none is.
        """
        self._node = node
        self._take = take
        self._await_image = await_image
        self._rhythm = Rhythm()
        self._timer: Timer | None = None
        self._busy = False

    def set_rate(self, camera: str, rate: float) -> None:
        """Set the images a second of testbed time of a camera [Hz]; 0: on demand only."""
        self._rhythm.set_rate(camera, rate)
        if not self._busy:
            self._await_image(self._rhythm.next_ns)
        if self._rhythm.active and self._timer is None:
            self._timer = self._node.create_timer(POLL_S, self._look, clock=self._node.steady_clock)
        elif not self._rhythm.active and self._timer is not None:
            self._node.destroy_timer(self._timer)
            self._timer = None

    def _look(self) -> None:
        if self._busy:
            return
        cameras = self._rhythm.due(self._node.get_clock().now().nanoseconds)
        if cameras:
            self._busy = True
            self._node.spawn(self._expose(cameras))

    async def _expose(self, cameras: tuple[str, ...]) -> None:
        try:
            self._rhythm.taken(cameras, await run_in_thread(self._node, self._take, cameras))
        except ImError as error:
            names = ", ".join(cameras)
            self._node.get_logger().warning(f"no image of {names}: {error.message}", throttle_duration_sec=5.0)
        finally:
            self._busy = False
            self._await_image(self._rhythm.next_ns)


class ControlParameters:
    """Parameters ``exposure``, and ``<camera>.gain``, ``<camera>.noise`` and ``<camera>.rate``, each with the range."""

    def __init__(self, node: ManagedNode, settings: VssSettings, controls: CameraControls, stream: ImageStream) -> None:
        """Declare and obey the parameters."""
        self._node = node
        self._controls = controls
        self._stream = stream
        self._cameras = settings.cameras
        exposure, ranges = settings.exposure, settings.controls
        declare = self._declare
        declare("exposure", exposure.nominal, exposure.shortest, exposure.longest, "that a request's 0 stands for [s]")
        for camera in settings.cameras:
            declare(f"{camera}.gain", 1.0, ranges.gain.low, ranges.gain.high, "relative to the data sheet")
            declare(f"{camera}.noise", 1.0, ranges.noise.low, ranges.noise.high, "read noise, by the data sheet's")
            declare(f"{camera}.rate", 0.0, ranges.rate.low, ranges.rate.high, "images a second of testbed time [Hz]")
        node.add_post_set_parameters_callback(self._changed)

    def start(self) -> None:
        """Obey the settings of the command line; images flow from now on."""
        self._apply(self._cameras)
        self._controls.set_exposure(self._value("exposure"))

    def _declare(self, name: str, value: float, low: float, high: float, what: str) -> None:
        self._node.declared.declare(name, value, what, span=(low, high), changeable=True)

    def _changed(self, parameters: list[Parameter]) -> None:
        names = {parameter.name.partition(".")[0] for parameter in parameters}
        if "exposure" in names:
            self._controls.set_exposure(self._value("exposure"))
        self._apply(tuple(camera for camera in self._cameras if camera in names))

    def _apply(self, cameras: tuple[str, ...]) -> None:
        for camera in cameras:
            gain, noise, rate = (self._value(f"{camera}.{control}") for control in ("gain", "noise", "rate"))
            self._controls.set_sensor(camera, SensorControls(gain, noise))
            self._stream.set_rate(camera, rate)

    def _value(self, name: str) -> float:
        return float(self._node.get_parameter(name).value)
