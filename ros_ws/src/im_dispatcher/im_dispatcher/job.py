"""One calibrate_camera command: the order, and the loop over the poses.

What is asked for is read once, and is a data object from then on. The loop is three numbers, which the command keeps in
its memory, so that a dispatcher that died goes on where it was and a pose costs the journal the same whether it is the
first or the thousandth.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from im_calibration import (
    TARGET_NOISE,
    CalibrationProblem,
    Observation,
    dataset_of,
    dataset_of_views,
    problem_of,
    views_of,
)
from im_calibration.targets.target import chessboard_of
from im_cell.robot import Cell, load_cell
from im_core.errors import DataError, NotFoundError, StateError
from im_dispatcher.poses_file import PosesFile, load_named_poses

#: As many spots as the solver asks for, of a camera with the usual lens.
FEWEST_POSES = 9

#: Failures that concern one pose only; everything else concerns the machine.
POSE_FAILURES = frozenset(
    {"unreachable", "collision", "limit", "not_settled", "spot_not_found", "spot_too_faint", "unusable"}
)


@dataclass(frozen=True)
class CalibrationOrder:
    """Order of a command.

    Attributes:
        cameras: Names of the cameras to calibrate.
        file: All poses, in order, and the arm that carries the light through them.
        target: Name of the chessboard on that arm which the cameras see in place of the light; empty: the light.
        accuracy_m: Expected error of a triangulated point at which it ends [m]; 0: all poses are visited.
    """

    cameras: tuple[str, ...]
    file: PosesFile
    target: str = ""
    accuracy_m: float = 0.0

    @property
    def light(self) -> str:
        """Name of the light for the cameras."""
        return f"{self.file.group}_led"


def order_of(
    arguments: Mapping[str, object],
    known_cameras: Sequence[str],
    load: Callable[[str], PosesFile] = load_named_poses,
) -> CalibrationOrder:
    """Read and check the order of a command.

    Args:
        arguments: Of the command, as its net declares them: ``cameras``, ``poses_file``, ``group``, and
            ``target`` and ``accuracy`` where they are asked for.
        known_cameras: Names of the cameras that exist; the first two are calibrated where none is named.
        load: Gives the poses of a file.

    Raises:
        NotFoundError: An unknown camera.
        DataError: A camera named twice, fewer poses than :data:`FEWEST_POSES`, poses of the other arm, arguments
            that no net has checked, or an accuracy for poses in a given order or for less than two fixed cameras.
        ConfigError: The poses file is missing, empty, or malformed, or the arm has no board.
    """
    match arguments:
        case {"cameras": list(named), "poses_file": str(path), "group": str(group)}:
            cameras, file = tuple(map(str, named)) or tuple(known_cameras[:2]), load(path)
        case _:
            raise DataError(f"calibrate_camera is to have cameras, poses_file and group, not {str(arguments)[:80]}")
    if file.group != group:
        raise DataError(f"the poses are those of the {file.group} arm, and the command has taken the {group} arm")
    for name in cameras:
        if name not in known_cameras:
            raise NotFoundError(kind="camera", name=name, known=known_cameras)
        if cameras.count(name) > 1:
            raise DataError(f"camera '{name}' is named twice", camera=name)
    if len(file.poses) < FEWEST_POSES:
        raise DataError(
            f"{len(file.poses)} poses are too few to calibrate a camera; at least {FEWEST_POSES} are needed",
            poses=len(file.poses),
            limit=FEWEST_POSES,
        )
    accuracy_m = float(str(arguments.get("accuracy", 0.0)))
    target = _board(cameras, group) if arguments.get("target") == "board" else ""
    if accuracy_m > 0.0:
        if target:
            raise DataError("an accuracy is for target light; with a board all poses are visited", argument="accuracy")
        _check_accuracy(cameras, file)
    return CalibrationOrder(cameras, file, target, accuracy_m)


def _board(cameras: Sequence[str], group: str) -> str:
    """Return the name of the board on an arm.

    Raises:
        ConfigError: The arm has none.
        DataError: A camera is on that arm, too, and sees its board from one side only.
    """
    cell = load_cell()
    board, moved = cell.board_of(group), set(cell.joints_of(group))
    for name in cameras:
        if moved & set(cell.carriers_of(cell.cameras[name].parent)):
            raise DataError(f"camera {name} is on the {group} arm, as {board.name} is", camera=name)
    return board.name


def _check_accuracy(cameras: Sequence[str], file: PosesFile) -> None:
    """Check that an accuracy can be asked for.

    Raises:
        DataError: The poses have a given order, or the cameras are not two or more that are fixed to the world.
    """
    if file.order != "free":
        raise DataError("an accuracy needs poses in free order; the poses file says order: given", argument="accuracy")
    fixed = [name for name in cameras if load_cell().cameras[name].parent == "world"]
    if len(fixed) < max(2, len(cameras)):
        told = f"{len(fixed)} of {', '.join(cameras)} are fixed"
        raise DataError(
            f"an accuracy in metres needs two cameras or more, all fixed to the world; {told}", cameras=fixed
        )


def dataset_of_command(cameras: Sequence[str], target: str, observations: Sequence[Observation]) -> dict[str, object]:
    """Return the data set of observations by some cameras, of a target, or of the light where it has no name.

    Raises:
        ImError: As of :func:`im_calibration.problem_of`.
    """
    cell = load_cell()
    if not target:
        return dataset_of(problem_of_light(cameras, observations))
    board = chessboard_of(cell, target)
    views = views_of(tuple(cameras), observations, board, _image_sizes(cell), cell.cameras)
    return dataset_of_views(views, TARGET_NOISE)


def _image_sizes(cell: Cell) -> dict[str, tuple[int, int]]:
    return {name: (camera.intrinsics.width, camera.intrinsics.height) for name, camera in cell.cameras.items()}


def problem_of_light(cameras: Sequence[str], observations: Sequence[Observation]) -> CalibrationProblem:
    """Return the observations of the cell's light by some cameras as the problem of a calibration.

    Raises:
        ImError: As of :func:`im_calibration.problem_of`.
    """
    cell = load_cell()
    led = cell.led.offset, cell.led.offset_prior_sd
    return problem_of(tuple(cameras), observations, (), _image_sizes(cell), led, cell.cameras, cell.workspace_box)


@dataclass(frozen=True)
class PoseVisit:
    """Visited pose.

    Attributes:
        number: Of the pose, from 1.
        longer: Whether it is exposed as for a light that was too faint.
    """

    number: int
    longer: bool = False


@dataclass
class PoseLoop:
    """Loop over the poses of one command: the arm is at one, or on the way there, during the look at another.

    Attributes:
        poses: How many there are.
        taken: How many have been visited, the present one included.
        skipped: How many of these were left out.
        again: Poses that are visited once more before the others.
        present: Where the arm is, or is going to; None where it is not known to be at a pose.
        looked: The pose in whose images the light is searched.
    """

    poses: int
    taken: int = 0
    skipped: int = 0
    again: tuple[PoseVisit, ...] = ()
    present: PoseVisit | None = None
    looked: PoseVisit | None = None

    @property
    def remaining(self) -> int:
        """The loop variable: poses not yet visited."""
        return self.poses - self.taken

    @property
    def progress(self) -> float:
        """Share of visited poses, 0..1."""
        return self.taken / self.poses

    @property
    def looked_number(self) -> int:
        """Number of the pose with the images under search.

        Raises:
            StateError: None was looked at.
        """
        if self.looked is None:
            raise StateError("no pose has been looked at")
        return self.looked.number

    @property
    def looked_progress(self) -> float:
        """Share of visited poses at the time of the last look, 0..1."""
        return self.looked_number / self.poses

    @property
    def following(self) -> int:
        """Number of the next pose of :meth:`next_pose`.

        Raises:
            DataError: None is left.
        """
        if not self.more_poses():
            raise DataError("all poses have been visited")
        return self.again[0].number if self.again else self.taken + 1

    def more_poses(self) -> bool:
        """Enabling function of loop_again; negated, of loop_done."""
        return bool(self.again) or self.remaining > 0

    def add_poses(self, count: int) -> None:
        """Add further poses behind the others."""
        self.poses += count

    def drop_poses(self, count: int) -> None:
        """Drop the next poses not yet visited."""
        self.poses -= count

    def next_pose(self) -> int:
        """Go on to the next pose, and return the number, from 1: a repeated one, or a new one.

        Raises:
            DataError: None is left.
        """
        number = self.following
        if self.again:
            self.present, *others = self.again
            self.again = tuple(others)
        else:
            self.taken, self.present = number, PoseVisit(number)
        return number

    def look(self) -> PoseVisit:
        """Note a look at the present pose, and return the visit.

        Raises:
            DataError: There is none.
        """
        if self.present is None:
            raise DataError("no pose has been taken yet")
        self.looked = self.present
        return self.present

    def give_back(self) -> None:
        """The present pose, if there is one, is to be visited again."""
        self._visit_again(self.present)
        self.present = None

    def give_back_looked(self, longer: bool = False) -> None:
        """Give the last seen pose back for another visit; ``longer``: with the exposure for a faint light."""
        if self.looked is not None:
            self._visit_again(PoseVisit(self.looked.number, longer or self.looked.longer))

    def skip(self) -> int:
        """Leave out a pose; returns how many were.

        Raises:
            DataError: None has been taken.
        """
        if self.taken == 0:
            raise DataError("no pose has been taken yet")
        self.skipped += 1
        return self.skipped

    def dispensable(self, failure_code: str) -> bool:
        """Return whether a failure concerns one pose only, and enough other poses remain."""
        return failure_code in POSE_FAILURES and self.poses - self.skipped - 1 >= FEWEST_POSES

    def to_json(self) -> list[object]:
        """The loop as JSON data."""
        visits = [[[visit.number, visit.longer] for visit in some] for some in (self.again, *self._hands())]
        return [self.poses, self.taken, self.skipped, *visits]

    @classmethod
    def from_json(cls, data: object) -> "PoseLoop":
        """Return the loop written by :meth:`to_json`.

        Raises:
            StateError: There is none.
        """
        match data:
            case [int(poses), int(taken), int(skipped), [*again], [*present], [*looked]]:
                visits, (arm,), (eye,) = _visits(again), _visits(present) or (None,), _visits(looked) or (None,)
                return cls(poses, taken, skipped, visits, arm, eye)
        raise StateError("no calibrate_camera command is running")

    def _hands(self) -> tuple[tuple[PoseVisit, ...], ...]:
        return tuple(() if visit is None else (visit,) for visit in (self.present, self.looked))

    def _visit_again(self, visit: PoseVisit | None) -> None:
        if visit is not None and visit.number not in (other.number for other in self.again):
            self.again = (*self.again, visit)


def _visits(data: Sequence[object]) -> tuple[PoseVisit, ...]:
    found = []
    for visit in data:
        match visit:
            case [int(number), bool(longer)]:
                found.append(PoseVisit(number, longer))
            case _:
                raise StateError(f"{visit!r} is no pose of a loop")
    return tuple(found)
