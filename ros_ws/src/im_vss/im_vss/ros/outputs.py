"""Topics of the cameras: images, spots, camera infos and static transforms."""

import threading

from geometry_msgs.msg import Point, PointStamped
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from tf2_msgs.msg import TFMessage

from im_cell.frames import Frame
from im_cell.frames import Image as Pixels
from im_core.ros import qos
from im_core.ros.node import ManagedNode
from im_vss.camera_book import CameraBook, CameraEntry
from im_vss.laser.book import LaserBook
from im_vss.ros.messages import to_camera_info, to_compressed, to_header, to_image, to_transform
from im_vss.stereo import ImageRectification


class ImageOutputs:
    """The :class:`im_vss.monitor.Screen` of the node: images are published to the subscribers."""

    def __init__(self, node: ManagedNode, book: CameraBook, laser: LaserBook | None) -> None:
        """Create ``image_raw``, ``camera_info``, ``image_display`` and ``spot`` of each camera, and ``/tf_static``.

        ``image_raw/compressed`` has the images once more, as JPEG, and ``image_rect`` rectified if the lens is known.
        Camera infos are latched: their publishers serve volatile subscribers too, and who comes later has the present
        calibration before the next image.
        """
        self._node = node
        self._book = book
        self._laser = laser
        self._telling = threading.Lock()
        names = [entry.name for entry in book.entries()]
        self._raw = self._publishers(names, Image, "image_raw", qos.IMAGES)
        self._compressed = self._publishers(names, CompressedImage, "image_raw/compressed", qos.IMAGES)
        self._rect = self._publishers(names, Image, "image_rect", qos.IMAGES)
        self._rectifications: dict[str, tuple[CameraEntry, ImageRectification]] = {}
        self._info = self._publishers(names, CameraInfo, "camera_info", qos.LATCHED)
        self._display = self._publishers(names, Image, "image_display", qos.IMAGES)
        self._spot = self._publishers(names, PointStamped, "spot", qos.EVENTS)
        self._tf_static = node.create_publisher(TFMessage, "/tf_static", qos.LATCHED)

    def raw(self, frame: Frame) -> None:
        """Publish an image as taken, and the camera info of the same stamp."""
        with self._telling:  # or a calibration that comes in between would be overwritten by the one before
            entry = self._book[frame.camera]
            self._info[frame.camera].publish(to_camera_info(entry, frame.stamp_ns))
        if self._raw[frame.camera].get_subscription_count():
            self._raw[frame.camera].publish(to_image(entry.frame, frame.stamp_ns, frame.image))
        if self._compressed[frame.camera].get_subscription_count():
            self._compressed[frame.camera].publish(to_compressed(entry.frame, frame.stamp_ns, frame.image))
        if entry.intrinsics_file is not None and self._rect[frame.camera].get_subscription_count():
            image = self._rectification(entry).apply(frame.image)
            self._rect[frame.camera].publish(to_image(entry.frame, frame.stamp_ns, image))

    def display(self, camera: str, image: Pixels, stamp_ns: int) -> None:
        """Publish the content of a monitor."""
        if self._display[camera].get_subscription_count():
            self._display[camera].publish(to_image(self._book[camera].frame, stamp_ns, image))

    def spot(self, camera: str, place: tuple[float, float], stamp_ns: int) -> None:
        """Publish the place of the light, x and y in pixels; data sets are made of such messages in bags."""
        header = to_header(self._book[camera].frame, stamp_ns)
        self._spot[camera].publish(PointStamped(header=header, point=Point(x=place[0], y=place[1])))

    def publish_calibrations(self) -> None:
        """Publish the calibrations and poses of cameras and laser scanner, as far as known."""
        stamp_ns = self._node.get_clock().now().nanoseconds
        with self._telling:
            places = []
            if self._laser is not None:
                scanner = self._laser.entry.model
                places.append(("world", "laser_scanner", scanner.position, scanner.rotation))
            for entry in self._book.entries():
                self._info[entry.name].publish(to_camera_info(entry, stamp_ns))
                places.append((entry.parent, entry.frame, entry.model.position, entry.model.R_cam_base.T))
            self._tf_static.publish(TFMessage(transforms=[to_transform(*place, stamp_ns) for place in places]))

    def _rectification(self, entry: CameraEntry) -> ImageRectification:
        """Return the rectification by the present calibration of a camera."""
        known, found = self._rectifications.get(entry.name, (None, None))
        if found is None or known is not entry:
            found = ImageRectification(entry.model, entry.rectified)
            self._rectifications[entry.name] = entry, found
        return found

    def _publishers(self, names: list[str], kind: type, topic: str, profile: QoSProfile) -> dict[str, Publisher]:
        return {name: self._node.create_publisher(kind, f"/{name}/{topic}", profile) for name in names}
