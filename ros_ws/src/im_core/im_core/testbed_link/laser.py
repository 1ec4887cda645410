"""The end of the testbed link of whoever drives the laser scanner."""

from im_core.testbed_link.block import LinkBlock
from im_core.testbed_link.values import LaserBeam


class LaserSide:
    """Commands mirrors and beam; one client at a time."""

    _shared: LinkBlock

    def set_laser(self, beam: LaserBeam) -> None:
        """Say what is wanted; the mirrors start to move with the next tick, and stop at their ends."""
        self._shared.view["laser_command"][:] = beam.values()

    def laser(self) -> LaserBeam:
        """What the scanner's own sensors say."""
        return LaserBeam(*self._shared.view["laser"].tolist())
