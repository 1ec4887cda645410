"""The Vision Modules of cameras, monitor and laser: snap, image display, spot display, laser."""

from dataclasses import replace
from functools import partial
from typing import ClassVar

from im_cell.frames import Exposed, Frame, FrameSet, SnapOrder, nobody
from im_cell.link import LaserBeam
from im_vss.laser.scanner import check_beam
from im_vss.managers.vmm import Lease
from im_vss.modules.module import VisionModule
from im_vss.monitor import Marker
from im_vss.rig import Rig

_SAME_S = 1e-6
"""Exposures that differ by less are of the same length."""


class VmSnap(VisionModule):
    """Takes images (paper: vmSnap)."""

    name: ClassVar[str] = "vm_snap"

    def snap(self, lease: Lease, order: SnapOrder, exposed: Exposed = nobody) -> FrameSet:
        """Expose all cameras of the order together, tell `exposed`, and read out the cameras.

        The client is told where the exposures were not of the length that was ordered. Where the robot held the cameras
        is noted.

        Raises:
            ImError: See :meth:`VisionModule.run` and :meth:`im_cell.frames.FrameSource.take_frames`.
        """
        parents = {self.rig.book[camera].parent for camera in order.cameras} - {"world"}
        noted: list[int] = []

        def note(stamps_ns: tuple[int, ...]) -> None:  # before the arm goes on, and its pose of then is forgotten
            noted.extend(stamps_ns)
            for parent in parents:
                self.rig.mounts.note(parent, stamps_ns)
            exposed(stamps_ns)

        frames = self.run(lease, partial(self.rig.cameras.take_frames, order, note))
        if abs(frames.exposure_s - order.exposure_s) > _SAME_S:
            lease.client.tell(f"exposed for {frames.exposure_s:g} s, not for {order.exposure_s:g} s")
        for camera, taken in frames.frames.items():
            if (parent := self.rig.book[camera].parent) != "world":
                self.rig.mounts.note(parent, [frame.stamp_ns for frame in taken if frame.stamp_ns not in noted])
        return frames


class VmImageDisp(VisionModule):
    """Shows images on the cameras' monitors (paper: vmImageDisp)."""

    name: ClassVar[str] = "vm_image_disp"

    def show(self, lease: Lease, frames: tuple[Frame, ...]) -> None:
        """Put each image out as taken, and on the camera's monitor.

        Raises:
            ImError: See :meth:`VisionModule.run`.
        """
        self.run(lease, partial(self._show, frames))

    def _show(self, frames: tuple[Frame, ...]) -> None:
        for frame in frames:
            self.rig.outputs.raw(frame)
            self.rig.monitors.show(frame)


class VmSpotDisp(VisionModule):
    """Draws markers over the images on the monitors (paper: vmSpotDisp)."""

    name: ClassVar[str] = "vm_spot_disp"

    def mark(self, lease: Lease, markers: tuple[Marker, ...]) -> None:
        """Draw the markers and show the result.

        Raises:
            ImError: See :meth:`VisionModule.run`.
        """
        self.run(lease, partial(self._mark, markers))

    def _mark(self, markers: tuple[Marker, ...]) -> None:
        for marker in markers:
            shown = self.rig.monitors.draw(marker)
            if shown is not None:
                self.rig.outputs.display(marker.camera, shown.image, shown.stamp_ns)


class VmLaser(VisionModule):
    """Moves the mirrors and switches the beam."""

    name: ClassVar[str] = "vm_laser"
    _shown: LaserBeam | None = None

    def __init__(self, rig: Rig) -> None:
        """Take over the scanner of `rig`, dark: the last user may have died with the beam on."""
        super().__init__(rig)
        if rig.laser is not None:
            rig.laser.scanner.darken()

    def drive(self, lease: Lease, beam: LaserBeam) -> tuple[LaserBeam, int]:
        """Show a beam; return the sensors' readings at the arrival, and the testbed time then [ns].

        Raises:
            LimitError: A mirror would turn too far.
            ImError: See :meth:`VisionModule.run` and :meth:`im_vss.laser.scanner.Scanner.drive`.
        """
        return self.run(lease, partial(self._drive, check_beam(beam, self.rig.cell.scanner)))

    def darken(self, beam: LaserBeam) -> None:
        """Switch a beam off, unless another one is shown by now; needs no lease, for a lease ended too early.

        Raises:
            ImError: See :meth:`im_vss.laser.scanner.Scanner.drive`.
        """
        self._thread.submit(self._darken, beam).result()

    def reading(self, lease: Lease) -> LaserBeam:
        """Return the readings of the scanner's sensors.

        Raises:
            ImError: See :meth:`VisionModule.run` and :meth:`im_vss.laser.scanner.Scanner.reading`.
        """
        return self.run(lease, self.rig.scanner.scanner.reading)

    def _drive(self, beam: LaserBeam) -> tuple[LaserBeam, int]:
        self._shown = beam
        scanner = self.rig.scanner.scanner
        stamp_ns = scanner.drive(beam, self.rig.settings.laser.settle)
        return scanner.reading(), stamp_ns

    def _darken(self, beam: LaserBeam) -> None:
        if self._shown is beam:
            self._drive(replace(beam, power=0.0))
