"""A part of an image."""

from dataclasses import dataclass

from im_cell.frames import Image
from im_core.errors import DataError

_SMALLEST_PX = 16


@dataclass(frozen=True)
class Region:
    """A rectangle of pixels: upper left corner and size [px]; a width of 0 stands for the whole image."""

    u: int = 0
    v: int = 0
    width: int = 0
    height: int = 0


WHOLE = Region()
"""The whole image."""


def check_region(region: Region, width: int, height: int) -> Region:
    """A region of an image of some size [px].

    Raises:
        DataError: It is not in the image, or too small to find anything in.
    """
    if region.width == 0:
        return WHOLE
    inside = region.u >= 0 and region.v >= 0 and region.u + region.width <= width
    if not inside or region.v + region.height > height or min(region.width, region.height) < _SMALLEST_PX:
        raise DataError(
            f"a region of {region.width} x {region.height} px at ({region.u}, {region.v}) px is not in the image of "
            f"{width} x {height} px, or smaller than {_SMALLEST_PX} px"
        )
    return region


def cut(image: Image, region: Region) -> tuple[Image, int, int]:
    """The pixels of a region, shape (h, w), and its upper left corner [px]."""
    if region.width == 0:
        return image, 0, 0
    return image[region.v : region.v + region.height, region.u : region.u + region.width], region.u, region.v
