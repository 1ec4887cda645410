"""Images at the cameras' rates."""

from collections.abc import Callable

from rclpy.timer import Timer

from im_core.errors import ImError
from im_core.ros.calls import run_in_thread
from im_core.ros.node import ManagedNode
from im_vss.rhythm import Rhythm

POLL_S = 0.01
"""Wall time between two looks at the clock, as often as ``/clock`` is published."""


class ImageStream:
    """Has images taken when :class:`im_vss.rhythm.Rhythm` says so, by the node's clock: testbed time with /clock."""

    def __init__(self, node: ManagedNode, take: Callable[[tuple[str, ...]], int]) -> None:
        """Nothing flows yet.

        Args:
            node: The node whose loop it runs in.
            take: Takes an image with each of some cameras at the same time, in a thread; when the exposure ended,
                testbed time [ns].
        """
        self._node = node
        self._take = take
        self._rhythm = Rhythm()
        self._timer: Timer | None = None
        self._busy = False

    def set_rate(self, camera: str, rate: float) -> None:
        """Set the images a second of testbed time of a camera [Hz]; 0: on demand only."""
        self._rhythm.set_rate(camera, rate)
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
