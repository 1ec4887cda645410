"""The cameras' controls as ROS parameters."""

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.parameter import Parameter

from im_core.ros.node import ManagedNode
from im_vss.camera_controls import CameraControls
from im_vss.frames import SensorControls
from im_vss.ros.image_stream import ImageStream
from im_vss.settings import VssSettings


class ControlParameters:
    """Declares ``exposure``, and ``<camera>.gain``, ``<camera>.noise`` and ``<camera>.rate``, each with its range."""

    def __init__(self, node: ManagedNode, settings: VssSettings, controls: CameraControls, stream: ImageStream) -> None:
        """Declare and obey the parameters.

        Args:
            node: The node whose parameters they are.
            settings: Cameras and ranges.
            controls: What is set.
            stream: Takes images at the cameras' rates.
        """
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
        """Obey what was given on the command line; images flow from now on."""
        self._apply(self._cameras)
        self._controls.set_exposure(self._value("exposure"))

    def _declare(self, name: str, value: float, low: float, high: float, what: str) -> None:
        span = FloatingPointRange(from_value=low, to_value=high)
        self._node.declare_parameter(name, value, ParameterDescriptor(description=what, floating_point_range=[span]))

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
