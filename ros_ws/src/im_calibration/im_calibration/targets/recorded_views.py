"""Views of a target in recordings: of each rest of the robot, or of each pose of a target, the image at rest."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from im_calibration.recorded.recordings import ImageRecording
from im_calibration.recorded.stamps import Stamps, moments
from im_calibration.targets.detection import Detection, detect
from im_calibration.targets.target import CalibrationTarget
from im_core.errors import DataError

Array = NDArray[np.float64]

Motion = Callable[[Stamps], Array]
"""Poses of the robot's link at some stamps, NaN where not known, shape (k,) [ns] -> (k, 4, 4)."""

_TOGETHER_S = 0.02
"""Images of several cameras so near in time are of one moment."""
_WINDOW_NS = 100_000_000
"""Before and after an image the robot has to be at rest so long: no stamp of a camera is exact."""
_REST_M, _REST_RAD = 1e-3, 2e-3
_REST_PX = 0.5
"""Largest move of the robot and of the target within one rest."""
_STILL_PX_S, _NEIGHBOUR_NS = 30.0, 250_000_000
"""Largest speed of a target held by hand, judged from the images before and after, if these are near."""
_SAME_SHARE = 0.03
"""Share of the image's width by which another view has moved."""
_MOST_DETECTIONS, _MOST_VIEWS = 3_000, 100


@dataclass(frozen=True)
class RecordedView:
    """Images of some cameras at one moment, or within one rest of the robot.

    Attributes:
        stamp_ns: Of the earliest image [ns].
        images: Rank of each camera's image, and the stamp [ns].
        found: What is seen in each camera's image.
    """

    stamp_ns: int
    images: Mapping[str, tuple[int, int]]
    found: Mapping[str, Detection]


@dataclass(frozen=True)
class ChosenViews:
    """Views for a calibration.

    Attributes:
        views: In order of time.
        sizes: Width and height of each camera's images [px].
        told: Sentences on what was left out.
    """

    views: Sequence[RecordedView]
    sizes: Mapping[str, tuple[int, int]]
    told: Sequence[str]


def views_at_rest(recordings: Mapping[str, ImageRecording], target: CalibrationTarget, motion: Motion) -> ChosenViews:
    """Choose one view of each rest of a robot.

    Raises:
        DataError: An image cannot be read, no pose is of the time of an image, or the robot never rests.
    """
    every = np.unique(np.concatenate([each.stamps for each in recordings.values()]))
    known, still = _at_rest(every, motion)
    if not known.any():
        raise DataError(f"{_span('images', every)}; no pose of the robot is of that time. Are both on one clock?")
    if not still.any():
        raise DataError(
            f"The robot moves by more than {1e3 * _REST_M:g} mm or {1e3 * _REST_RAD:g} mrad within "
            f"{2e-9 * _WINDOW_NS:g} s of each of the {known.sum()} images with a pose; let it rest at each pose."
        )
    rests = list(_rests(every[still], motion))
    wanted = {name: dict(_near_middle(each.stamps, rests)) for name, each in recordings.items()}
    seen, sizes = _detected(
        recordings, target, {name: set().union(*ranks.values()) if ranks else set() for name, ranks in wanted.items()}
    )
    views, shaken = [], 0
    for k in range(len(rests)):
        images, found, moves = {}, dict[str, Detection](), False
        for name, recording in recordings.items():
            of_rest = [(rank, seen[name][rank]) for rank in wanted[name].get(k, ()) if rank in seen[name]]
            if of_rest:
                images[name] = (of_rest[0][0], int(recording.stamps[of_rest[0][0]]))
                found[name] = of_rest[0][1]
                moves |= len(of_rest) > 1 and _moved_px(of_rest[0][1], of_rest[1][1]) > _REST_PX
        shaken += moves
        if found and not moves:
            views.append(RecordedView(min(stamp for _, stamp in images.values()), images, found))
    told = [
        f"{len(every)} images: {(~known).sum()} without a pose of the robot, {(known & ~still).sum()} while it moves; "
        f"{len(rests)} rests, the target is seen in {len(views) + shaken}"
    ]
    if shaken:
        told.append(f"{shaken} rests are left out: the target moves by more than {_REST_PX:g} px while the robot rests")
    return ChosenViews(views, sizes, told + [each.told for each in recordings.values() if each.told])


def views_in_motion(recordings: Mapping[str, ImageRecording], target: CalibrationTarget) -> ChosenViews:
    """Choose the stillest of successive images that show the target at about one place.

    Raises:
        DataError: An image cannot be read.
    """
    told = list[str]()
    ranks = {}
    for name, recording in recordings.items():
        count = len(recording.stamps)
        step = 1 if count <= _MOST_DETECTIONS else -(-2 * count // _MOST_DETECTIONS)
        ranks[name] = {i for k in range(0, count, step) for i in (k, k + 1) if i < count}  # two show the motion
        if step > 1:
            told.append(f"{name}: has {count} images, two in {step} are looked at")
    seen, sizes = _detected(recordings, target, ranks)
    names = list(recordings)
    looked = {name: sorted(seen[name]) for name in names}
    together = moments([recordings[name].stamps[looked[name]] for name in names], _TOGETHER_S)
    best, last = list[tuple[float, RecordedView]](), dict[str, Detection]()
    for group in together:
        images = {names[c]: (looked[names[c]][i], stamp) for c, (stamp, i) in group.items()}
        found = {name: seen[name][rank] for name, (rank, _) in images.items()}
        speed = max(_speed(recordings[name], ranks[name], seen[name], rank) for name, (rank, _) in images.items())
        view = RecordedView(min(stamp for _, stamp in images.values()), images, found)
        if found.keys() != last.keys() or any(
            _moved_px(found[name], last[name]) > _SAME_SHARE * sizes[name][0] for name in found
        ):
            best.append((speed, view))
            last = found
        elif speed < best[-1][0]:
            best[-1] = (speed, view)
    views = [view for speed, view in best if speed <= _STILL_PX_S]
    told.append(
        f"{sum(map(len, ranks.values()))} images, {len(together)} moments show the target; "
        f"of {len(best)} different views {len(best) - len(views)} move by more than {_STILL_PX_S:g} px/s"
    )
    if len(views) > _MOST_VIEWS:
        told.append(f"of {len(views)} views {_MOST_VIEWS} are taken")
        views = [views[i] for i in np.linspace(0, len(views) - 1, _MOST_VIEWS).round().astype(int)]
    return ChosenViews(views, sizes, told + [each.told for each in recordings.values() if each.told])


def _detected(
    recordings: Mapping[str, ImageRecording], target: CalibrationTarget, ranks: Mapping[str, set[int]]
) -> tuple[dict[str, dict[int, Detection]], dict[str, tuple[int, int]]]:
    """Return what is found in some images of each camera, and the sizes of the images."""
    seen, sizes = {}, dict[str, tuple[int, int]]()
    for name, recording in recordings.items():
        seen[name] = dict[int, Detection]()
        for rank, image in recording.images(ranks[name]):
            here = (image.shape[1], image.shape[0])
            if sizes.setdefault(name, here) != here:
                raise DataError(
                    f"{recording.name}: image {rank + 1} has {here[0]} x {here[1]} px, those before {sizes[name][0]} x "
                    f"{sizes[name][1]}: images of one camera have one size.",
                    camera=name,
                )
            if (found := detect(image, target)) is not None:
                seen[name][rank] = found
    return seen, sizes


def _at_rest(stamps: Stamps, motion: Motion) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return whether the robot's pose is known at each stamp, and whether it is at rest around."""
    steps = np.linspace(-_WINDOW_NS, _WINDOW_NS, 9).astype(np.int64)
    around = motion((stamps[:, None] + steps).ravel()).reshape(len(stamps), len(steps), 4, 4)
    middle = motion(stamps)
    known = np.isfinite(middle[:, 0, 0])
    moved = [_apart(middle, around[:, k]) for k in range(len(steps))]
    # what is not known around a known pose, as at the ends, moves nothing
    return known, np.asarray(known & ~np.any([(m > _REST_M) | (r > _REST_RAD) for m, r in moved], axis=0))


def _rests(stamps: Stamps, motion: Motion) -> Iterator[tuple[int, int]]:
    """Yield the first and last stamp of successive images at one pose [ns]."""
    poses = motion(stamps)
    begin = 0
    for i in range(1, len(stamps) + 1):
        if i < len(stamps):
            metres, radians = _apart(poses[begin : begin + 1], poses[i : i + 1])
            if metres[0] <= _REST_M and radians[0] <= _REST_RAD:
                continue
        yield int(stamps[begin]), int(stamps[i - 1])
        begin = i


def _apart(one: Array, other: Array) -> tuple[Array, Array]:
    """Return distances [m] and angles [rad] between poses, shape (k, 4, 4) each."""
    metres = np.linalg.norm(one[:, :3, 3] - other[:, :3, 3], axis=1)
    turned = one[:, :3, :3] - other[:, :3, :3]  # of Frobenius norm 2 sqrt(2) sin(angle / 2)
    return metres, 2.0 * np.arcsin(np.minimum(1.0, np.linalg.norm(turned, axis=(1, 2)) / np.sqrt(8.0)))


def _near_middle(stamps: Stamps, rests: list[tuple[int, int]]) -> Iterator[tuple[int, list[int]]]:
    """Yield, for each rest with images of a camera, the two nearest the middle: one to measure, one to compare."""
    for k, (first, last) in enumerate(rests):
        inside = np.flatnonzero((first <= stamps) & (stamps <= last))
        if len(inside):
            nearest = inside[np.argsort(np.abs(stamps[inside] - (first + last) // 2), kind="stable")]
            yield k, nearest[:2].tolist()


def _moved_px(one: Detection, other: Detection) -> float:
    """Return the median move of the points found in both, infinite if there is none [px]."""
    moves = np.linalg.norm(one.points - other.points, axis=1)
    moves = moves[np.isfinite(moves)]
    return float(np.median(moves)) if len(moves) else np.inf


def _speed(recording: ImageRecording, looked: set[int], seen: Mapping[int, Detection], rank: int) -> float:
    """Return the speed of a target to the image before or after, the smaller one, 0 where none is near [px/s].

    Where the target is found in no image near, it may be blurred there: the speed is infinite.
    """
    stamps = recording.stamps
    near = [i for i in {rank - 1, rank + 1} & looked if abs(int(stamps[i] - stamps[rank])) <= _NEIGHBOUR_NS]
    moves = [(_moved_px(seen[rank], seen[i]), 1e-9 * abs(int(stamps[i] - stamps[rank]))) for i in near if i in seen]
    return min((px / max(lasted, 1e-6) for px, lasted in moves), default=np.inf if near else 0.0)


def _span(what: str, stamps: Stamps) -> str:
    return f"The {what} are from {stamps[0] * 1e-9:.3f} to {stamps[-1] * 1e-9:.3f} s"
