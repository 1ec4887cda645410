"""Images of a folder or a recording, and the views of a target in the images."""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from im_calibration.recorded.image_message import Image
from im_calibration.recorded.recordings import ImageRecording
from im_calibration.targets.detection import chessboard_in, detect, markers_in
from im_calibration.targets.recorded_views import Motion, views_at_rest, views_in_motion
from im_calibration.targets.target import CalibrationTarget
from im_calibration.targets.views import ShownViews
from im_core.errors import DataError
from im_core.files import MEBIBYTE, read_bytes

Array = NDArray[np.float64]

_ENDINGS = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".ppm", ".webp")
_LARGEST_IMAGE, _MOST_IMAGES = 200 * MEBIBYTE, 5_000
_BLANK, _FEWEST_VIEWS, _TRIED, _SEARCHED, _MOST_NAMES = 6.0, 3, 6, 2, 10


@dataclass(frozen=True)
class SeenTarget:
    """Points of a target in the images of some cameras.

    Attributes:
        image_sizes: Width and height of each camera's images [px].
        names: Names of the k views: of images of the same name, without the ending, in any camera; or the stamps [s].
        spots: Points, NaN where not found, shape (c, k, p, 2) [px].
        deviations: Standard deviation of each coordinate by the noise of the image, NaN where not known, shape
            (c, k, p) [px].
        told: Sentences on images in which it was found, and on those left out.
        shown: Of each camera, the name of the view in which most points were found, and the image.
        stamps: When the views were recorded, shape (k,) [ns]; None: not known.
    """

    image_sizes: tuple[tuple[int, int], ...]
    names: tuple[str, ...]
    spots: Array
    deviations: Array
    told: Sequence[str]
    shown: ShownViews
    stamps: NDArray[np.int64] | None = None

    def with_poses(self, posed: Collection[str], source: Path) -> Self:
        """Return the views for which a file has a pose of the robot; the others are told.

        Args:
            posed: Names of views.
            source: The file.
        """
        known = np.array([name in posed for name in self.names])
        if known.all():
            return self
        names = tuple(name for name in self.names if name in posed)
        absent = [name for name in self.names if name not in posed]
        first = ", ".join(absent[:_MOST_NAMES]) + "..." * (len(absent) > _MOST_NAMES)
        told = f"{source}: no pose for {len(absent)} of {len(self.names)} images, which are left out: {first}"
        spots, deviations = self.spots[:, known], self.deviations[:, known]
        return replace(self, names=names, spots=spots, deviations=deviations, told=[*self.told, told])


def read_image(path: Path) -> Image:
    """Return a grey image of 8 or 16 bits from a file of any usual kind.

    Raises:
        DataError: It cannot be read, or is no image.
    """
    data = np.frombuffer(read_bytes(path, _LARGEST_IMAGE), dtype=np.uint8)
    image = cv2.imdecode(data, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_GRAYSCALE) if len(data) else None
    if image is None or image.dtype not in (np.uint8, np.uint16):
        raise DataError(f"{path}: is no image of 8 or 16 bits.", file=str(path))
    return np.asarray(image, dtype=np.uint8) if image.dtype == np.uint8 else np.asarray(image, dtype=np.uint16)


def find_target(
    sources: Mapping[str, Path | ImageRecording], target: CalibrationTarget, motion: Motion | None = None
) -> SeenTarget:
    """Find a target in the images of each camera.

    Args:
        sources: Folder of each camera, of which each image counts, or the recording, of which views are chosen.
        target: The target.
        motion: Where the robot was in recordings.

    Raises:
        DataError: A folder has no images, or images of two sizes; or the target is in too few of them: told is what
            may be wrong, and with which other rows and columns it is found.
    """
    recordings = {name: source for name, source in sources.items() if isinstance(source, ImageRecording)}
    if not recordings:
        return _in_folders({name: source for name, source in sources.items() if isinstance(source, Path)}, target)
    if len(recordings) < len(sources):
        raise DataError("Cameras have images of folders and of recordings; which belong together is not known.")
    chosen = views_at_rest(recordings, target, motion) if motion else views_in_motion(recordings, target)
    stamps = np.array([view.stamp_ns for view in chosen.views], dtype=np.int64)
    names = tuple(f"{stamp // 10**9}.{stamp % 10**9:09d}" for stamp in stamps.tolist())
    count = (len(recordings), len(chosen.views), len(target.points))
    spots, deviations = np.full((*count, 2), np.nan), np.full(count, np.nan)
    told, shown = list(chosen.told), dict[str, tuple[str, Image]]()
    for c, (name, recording) in enumerate(recordings.items()):
        for k, view in enumerate(chosen.views):
            if name in view.found:
                spots[c, k], deviations[c, k] = view.found[name].points, view.found[name].standard_deviations
        seen = sum(name in view.found for view in chosen.views)
        told.append(f"{name}: {target} taken in {seen} views")
        if seen < _FEWEST_VIEWS:
            some = np.unique(np.linspace(0, len(recording.stamps) - 1, _TRIED).astype(int)).tolist()
            raise DataError(
                f"{recording.name}: the target {target} can be used in {seen} views, {_FEWEST_VIEWS} are needed: "
                f"{'; '.join(chosen.told)}. {_advice([image for _, image in recording.images(some)], target)}",
                camera=name,
            )
        fullest = int(np.isfinite(spots[c, ..., 0]).sum(axis=1).argmax())
        shown[name] = names[fullest], next(recording.images([chosen.views[fullest].images[name][0]]))[1]
    return SeenTarget(tuple(chosen.sizes[name] for name in recordings), names, spots, deviations, told, shown, stamps)


def _in_folders(folders: Mapping[str, Path], target: CalibrationTarget) -> SeenTarget:
    files = {name: _images(folder) for name, folder in folders.items()}
    names = sorted({path.stem for paths in files.values() for path in paths})
    count = (len(folders), len(names), len(target.points))
    spots, deviations = np.full((*count, 2), np.nan), np.full(count, np.nan)
    sizes, told, shown = [], list[str](), dict[str, tuple[str, Image]]()
    for c, (name, paths) in enumerate(files.items()):
        size: tuple[int, int] | None = None
        missing, most = list[str](), 0
        for path in paths:
            image = read_image(path)
            here = (image.shape[1], image.shape[0])
            size = size or here
            if here != size:
                raise DataError(
                    f"{path} has {here[0]} x {here[1]} px, {paths[0].name} {size[0]} x {size[1]}: images of one camera "
                    "have one size.",
                    file=str(path),
                )
            if float(np.ptp(np.percentile(image, (1.0, 99.0)))) < _BLANK * (1.0 if image.dtype == np.uint8 else 257.0):
                missing.append(f"{path.name} is blank")
            elif found := detect(image, target):
                spots[c, names.index(path.stem)] = found.points
                deviations[c, names.index(path.stem)] = found.standard_deviations
                if found.count > most:
                    most, shown[name] = found.count, (path.stem, image)
            else:
                missing.append(f"{path.name} does not show it")
        sizes.append(size or (0, 0))
        seen = len(paths) - len(missing)
        if seen < min(_FEWEST_VIEWS, len(paths)):
            tried = [read_image(path) for path in paths[:: max(1, len(paths) // _TRIED)]]
            raise DataError(
                f"{name}: the target {target} was found in {seen} of {len(paths)} images"
                f"{': ' + ', '.join(missing[:3])}. {_advice(tried, target)}",
                camera=name,
            )
        told += [f"{name}: {target} found in {seen} of {len(paths)} images", *(f"  {reason}" for reason in missing)]
    return SeenTarget(tuple(sizes), tuple(names), spots, deviations, told, shown)


def _images(folder: Path) -> list[Path]:
    try:
        paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in _ENDINGS)
    except OSError as error:
        raise DataError(f"{folder}: cannot be read: {error.strerror}.", file=str(folder)) from error
    if not paths:
        raise DataError(f"{folder}: has no images; known are {', '.join(_ENDINGS)}.", file=str(folder))
    if len(paths) > _MOST_IMAGES:
        raise DataError(f"{folder}: has {len(paths)} images, at most {_MOST_IMAGES} are read.", file=str(folder))
    stems = [path.stem for path in paths]
    if len(set(stems)) < len(stems):
        double = next(stem for stem in stems if stems.count(stem) > 1)
        raise DataError(f"{folder}: has two images named {double}; which is which?", file=str(folder))
    return paths


def _advice(tried: list[Image], target: CalibrationTarget) -> str:
    """Return advice, after a trial of the sizes for which such targets are mistaken."""
    for other, meaning in _mistaken(target, tried):
        found = sum(detect(image, other) is not None for image in tried)
        if found > len(tried) // 2:
            return f"As {other} it is found in {found} of {len(tried)}: {meaning}."
    if target.dictionary:
        dictionary, numbers = markers_in(tried[:_SEARCHED])
        if dictionary:
            return f"Markers {numbers[0]} to {numbers[-1]} of {dictionary} are seen, {len(numbers)} numbers."
    return "Check its rows, columns and dictionary, that it is whole, flat and sharp, with a bright rim around it."


def _mistaken(target: CalibrationTarget, tried: list[Image]) -> Iterator[tuple[CalibrationTarget, str]]:
    """Yield targets often taken for a target, and the chessboard that images show, with the mistake."""
    columns, rows = target.columns, target.rows
    sizes = [(rows, columns, "rows and columns are exchanged")]
    if target.kind == "chessboard":
        for sides, _ in Counter(filter(None, map(chessboard_in, tried))).most_common(1):
            seen = sides if columns >= rows else sides[::-1]
            again = "count its inner corners" + (", not its squares" if seen == (columns - 1, rows - 1) else " again")
            sizes.append((*seen, again))
    elif target.kind == "charuco":
        sizes.append((columns + 1, rows + 1, "count its squares, not its inner corners"))
    for other_columns, other_rows, meaning in sizes:
        if (other_columns, other_rows) != (columns, rows) and min(other_columns, other_rows) >= 2:
            yield replace(target, columns=other_columns, rows=other_rows), meaning
    if target.kind == "tags":
        upwards = replace(target, upwards=not target.upwards)
        if upwards.upwards:
            yield upwards, "its rows are counted from the bottom, as Kalibr does; give Kalibr's file of it"
        else:
            yield upwards, "its rows are counted from the top; give it in this form"
