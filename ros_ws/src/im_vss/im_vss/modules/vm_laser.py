"""Vision Module of the laser scanner."""

from dataclasses import replace
from functools import partial
from typing import ClassVar

from im_cell.link import LaserBeam
from im_vss.laser.scanner import check_beam
from im_vss.managers.vmm import Lease
from im_vss.modules.module import VisionModule
from im_vss.rig import Rig


class VmLaser(VisionModule):
    """Moves the mirrors and switches the beam."""

    name: ClassVar[str] = "vm_laser"
    _shown: LaserBeam | None = None

    def __init__(self, rig: Rig) -> None:
        """Take over the scanner of `rig`, dark: whoever had it may have died with the beam on."""
        super().__init__(rig)
        if rig.laser is not None:
            rig.laser.scanner.darken()

    def drive(self, lease: Lease, beam: LaserBeam) -> tuple[LaserBeam, int]:
        """Show a beam; what the scanner's sensors say when it is there, and the testbed time then [ns].

        Raises:
            LimitError: A mirror would turn too far.
            ImError: See :meth:`VisionModule.run` and :meth:`im_vss.laser.scanner.Scanner.drive`.
        """
        return self.run(lease, partial(self._drive, check_beam(beam, self.rig.cell.laser)))

    def darken(self, beam: LaserBeam) -> None:
        """Switch a beam off, unless another one is shown by now; needs no lease, for when that ended too early.

        Raises:
            ImError: See :meth:`im_vss.laser.scanner.Scanner.drive`.
        """
        self._thread.submit(self._darken, beam).result()

    def reading(self, lease: Lease) -> LaserBeam:
        """What the scanner's sensors say.

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
