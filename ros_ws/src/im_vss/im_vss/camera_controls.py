"""What can be set at the cameras while they run."""

import threading

from im_vss.frames import SensorControls


class CameraControls:
    """Controls of each camera, and the exposure time that all share; any thread may set and read them."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._sensors: dict[str, SensorControls] = {}
        self._exposure_s: float | None = None

    def set_sensor(self, camera: str, controls: SensorControls) -> None:
        """Set gain and noise of a camera from its next exposure on."""
        with self._lock:
            self._sensors[camera] = controls

    def set_exposure(self, exposure_s: float) -> None:
        """Set the exposure time that a request's 0 stands for [s]."""
        with self._lock:
            self._exposure_s = exposure_s

    def sensors(self, cameras: tuple[str, ...]) -> dict[str, SensorControls]:
        """The controls of some cameras."""
        with self._lock:
            return {camera: self._sensors.get(camera, SensorControls()) for camera in cameras}

    def exposure(self, wanted: float, nominal: float) -> float:
        """The exposure time for a request [s]: what is wanted, or what was set, or the nominal one."""
        with self._lock:
            return wanted or self._exposure_s or nominal
