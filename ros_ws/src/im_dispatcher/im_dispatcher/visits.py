"""Visits of one calibrate_camera command: their poses, their names, and the loop over them.

Poses are visited as they are listed; in free order, in the order that was found for them; or, for an accuracy, in looks
that are planned while the command runs, some of them at the same pose. What is known of that is in the memory and the
replies of the command, for a dispatcher that died goes on with it.
"""

from im_dispatcher.job import PoseLoop
from im_dispatcher.poses_file import PosesFile
from im_pnt.execution.functions import ActionContext

#: Transition whose answer is the order of poses in free order.
ORDER = "order_poses"


class Visits:
    """The visits, numbered from 1, and the loop over them."""

    def __init__(self, ctx: ActionContext) -> None:
        self._ctx = ctx

    @property
    def loop(self) -> PoseLoop:
        """Copy of the loop as kept last."""
        return PoseLoop.from_json(self._ctx.memory.get("loop"))

    def keep(self, loop: PoseLoop) -> None:
        """Keep the loop in memory."""
        self._ctx.memory["loop"] = loop.to_json()

    @property
    def for_accuracy(self) -> bool:
        """Whether visits are planned for an accuracy."""
        return "accuracy" in self._ctx.memory

    @property
    def asked_m(self) -> float:
        """The accuracy asked for [m]."""
        return float(str(self._told("asked_m")))

    @property
    def planned(self) -> list[int]:
        """Numbers of poses of the visits planned for an accuracy, one a look."""
        return self._numbers("visits")

    @property
    def barred(self) -> list[int]:
        """Numbers of failed poses, not planned again."""
        return self._numbers("barred")

    def begin(self, accuracy_m: float) -> None:
        """Begin without any visit, to plan for an accuracy."""
        self._plan(accuracy_m, [], [])
        self.keep(PoseLoop(0))

    def add(self, poses: list[int]) -> PoseLoop:
        """Plan visits behind the others, and return the longer loop."""
        loop = self.loop
        loop.add_poses(len(poses))
        self._plan(self.asked_m, self.planned + poses, self.barred)
        self.keep(loop)
        return loop

    def bar(self, number: int) -> None:
        """Plan no further look at the pose of a failed visit."""
        if not self.for_accuracy:
            return
        loop, planned, pose = self.loop, self.planned, self.pose_of(number)
        kept = planned[: loop.taken] + [each for each in planned[loop.taken :] if each != pose]
        loop.drop_poses(len(planned) - len(kept))
        self._plan(self.asked_m, kept, sorted({*self.barred, pose}))
        self.keep(loop)

    @property
    def order_found(self) -> list[int] | None:
        """Numbers of the poses in the order of the visits, None before an answer."""
        match self._ctx.replies.get(ORDER):
            case {"order": list(numbers)}:
                return [int(str(number)) for number in numbers]
        return None

    @property
    def as_listed(self) -> bool:
        """Whether the poses are visited one after the other as they are listed."""
        return not self.for_accuracy and self.order_found is None

    def pose_of(self, number: int) -> int:
        """Return the number in the poses file, from 1, of a visit."""
        order = self.planned if self.for_accuracy else self.order_found
        return number if order is None else order[number - 1]

    def observation_of(self, number: int) -> int:
        """Return the number of the observation of a visit: that of the pose, or of the look for an accuracy."""
        return number if self.for_accuracy else self.pose_of(number)

    def name_of(self, number: int, file: PosesFile) -> str:
        """Return the name of a visit: the pose, and for an accuracy the number of the look."""
        pose = file.poses[self.pose_of(number) - 1].name
        if not self.for_accuracy:
            return pose
        planned = self.planned
        return f"{pose[:56]}/{planned[:number].count(planned[number - 1])}"

    def names(self, file: PosesFile) -> list[str]:
        """Return the names of all visits."""
        count = self.loop.poses if self.for_accuracy else len(file.poses)
        return [self.name_of(number, file) for number in range(1, count + 1)]

    def _told(self, what: str) -> object:
        told = self._ctx.memory["accuracy"]
        assert isinstance(told, dict)
        return told[what]

    def _numbers(self, what: str) -> list[int]:
        told = self._told(what)
        assert isinstance(told, list)
        return list(told)

    def _plan(self, asked_m: float, visits: list[int], barred: list[int]) -> None:
        self._ctx.memory["accuracy"] = {"asked_m": asked_m, "visits": visits, "barred": barred}
