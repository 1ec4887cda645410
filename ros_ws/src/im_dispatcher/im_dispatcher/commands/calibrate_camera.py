"""Functions of ``nets/calibrate_camera.yaml``; the net decides on the order.

What a command has collected is in its memory (``ctx.memory``), which does not grow from pose to pose, and in data
objects; every function may be done twice: a dispatcher that died goes on with the command when it is back.
"""

import contextlib
import json
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from im_calibration import write_observations
from im_calibration.problem.observations import observation_of
from im_cell.robot import load_cell
from im_core import clock
from im_core.errors import BEGUN_ANEW, ImError, NotFoundError, StateError, StoreError
from im_core.names import results_dir
from im_core.text.bounded_json import read_json
from im_dispatcher.accuracy import accuracy_reached, next_visits
from im_dispatcher.command import CommandDescription
from im_dispatcher.expectation import beside, expectation
from im_dispatcher.job import PoseLoop, dataset_of_command, order_of
from im_dispatcher.poses_file import PosesFile, load_named_poses
from im_dispatcher.report import StepTimes, failed, make_directory, succeeded, write_report
from im_dispatcher.visits import Visits
from im_pnt.execution.functions import ActionContext, Functions, idempotent, woken_by
from im_pnt.execution.jobs import Job
from im_pnt_analysis import CommandDuration
from im_pnt_node.rerun.host import Host

SYMBOL = "calibrate_camera"

#: Data object: the poses of the command.
POSES = "calibration_poses"

#: Types of the data objects.
TEXT, POSE, REJECTION = "std_msgs/msg/String", "geometry_msgs/msg/PoseStamped", "im_msgs/msg/Rejection"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
REPORT, OBSERVATION = "im_msgs/msg/CalibrationReport", "im_msgs/msg/Observation"

#: Arguments of the command that name its poses, and their defaults.
_NAMED_POSES = {"poses_file": "", "target": "light"}

#: How often in a row, without a pose in between, what was established is established again.
MOST_TAKE_UPS = 5

#: Codes of the failure to find the light: with more of it there may be a spot, or there are no images any more.
TOO_FAINT, FORGOTTEN = "spot_too_faint", "look_forgotten"


class CalibrateCamera:
    """The functions of the command."""

    def __init__(self, host: Host, times: StepTimes) -> None:
        self._host, self._times = host, times
        self._cameras = list(load_cell().cameras)
        self._expected: CommandDuration | None = None
        self._file: tuple[int, PosesFile] | None = None

    @property
    def functions(self) -> Functions:
        """Actions, builders of requests and enabling functions by the names in the net; all may be done twice."""
        actions = {
            action.__name__: action
            for action in (
                self.init_calib,
                self.read_next_pos,
                self.read_planned_pos,
                self.visit_again,
                self.skip_pose,
                self.skip_look,
                self.note_unkept,
                self.assess,
                self.take_up,
                self.write_report,
                self.note_left,
                self.note_failure,
                self.note_listed,
                self.report_failure,
            )
        }
        requests = (
            self.other_arm,
            self.require_other,
            self.poses_to_order,
            self.way_known,
            self.present_look,
            self.next_destination,
            self.watchers,
            self.looked_pose,
            self.collected,
        )
        builders = {build.__name__: build for build in requests}
        guards = {
            "other_needed": woken_by()(_other_needed),
            "order_wanted": woken_by()(_order_wanted),
            "more_poses": woken_by()(_more_poses),
            "goes_on": woken_by()(_goes_on),
            "plans_ahead": woken_by()(_plans_ahead),
            "stays": woken_by()(_stays),
            "all_planned_taken": woken_by()(_all_planned_taken),
            "another_visit_may_help": woken_by()(_another_visit_may_help),
            "pose_dispensable": woken_by()(_dispensable),
            "begun_anew": woken_by()(_begun_anew),
        }
        asks = {name: idempotent(action) for name, action in actions.items()}
        return Functions({**actions, **builders}, guards, asks)

    # In the order of the net.

    async def init_calib(self, ctx: ActionContext) -> None:
        """Read the poses and set the loop variable."""
        self._times.restart(ctx.command.id)
        ctx.memory["begun_ms"] = ctx.memory["seen_ms"] = self._clocks_ms()
        named = [str(ctx.request_arguments.get(name, other)) for name, other in _NAMED_POSES.items()]
        text = await self._host.noted_apart("poses", _poses_text, *named)
        file = read_json(PosesFile, text, "the poses")
        order = order_of(ctx.request_arguments, self._cameras, lambda _: file)
        poses = len(order.file.poses)
        ctx.memory["directory"] = self._host.noted("directory", _new_directory)
        ctx.memory["cameras"] = list(order.cameras)
        ctx.memory["light"], ctx.memory["target"] = order.light, order.target
        ctx.memory["free"] = order.file.order == "free" and order.accuracy_m == 0.0
        ctx.memory["other"] = "" if order.file.other_joints is None else order.file.other
        Visits(ctx).keep(PoseLoop(poses))
        await self._host.values.put(ctx.object(POSES), TEXT, {"data": order.file.model_dump_json()})
        self._file = ctx.command.id, order.file
        if order.accuracy_m > 0.0:
            Visits(ctx).begin(order.accuracy_m)
            await self._plan_visits(ctx)
            ctx.progress(f"{1e3 * order.accuracy_m:g} mm of {', '.join(order.cameras)}", 0.0)
            return
        ctx.progress(f"{poses} poses for {', '.join(order.cameras)}", 0.0)

    def other_arm(self, ctx: ActionContext) -> dict[str, object]:
        """Return the arm without the light."""
        return {"group": ctx.memory["other"]}

    async def require_other(self, ctx: ActionContext, answer: Any) -> None:
        """Check that the other arm, in an ``im_msgs/srv/GetGroupState`` response, stands where the poses need it."""
        (await self._poses(ctx)).require_other(answer.state.joints, answer.state.q)

    async def poses_to_order(self, ctx: ActionContext) -> dict[str, object]:
        """Store the joints of all poses, and return the name of the data object."""
        file = await self._poses(ctx)
        points = [{"positions": list(pose.joints or ())} for pose in file.poses]
        joints = list(load_cell().joints_of(file.group))
        await self._host.values.put(ctx.object("positions"), TRAJECTORY, {"joint_names": joints, "points": points})
        return {"positions": "positions"}

    async def note_listed(self, ctx: ActionContext) -> None:
        """Tell the reason of a visit of the poses as they are listed."""
        ctx.memory["free"] = False
        ctx.progress(f"the poses are visited as they are listed: {_reason(ctx)}", 0.0)

    async def read_next_pos(self, ctx: ActionContext) -> None:
        """Count the loop variable down and store the next destination."""
        visits, file = Visits(ctx), await self._poses(ctx)
        loop = visits.loop
        done, number = loop.progress, loop.next_pose()
        pose = file.poses[visits.pose_of(number) - 1]
        visits.keep(loop)
        ctx.memory["pose"] = visits.name_of(number, file)
        ctx.memory["planned"] = False
        ctx.memory["times"] = self._host.noted("times", lambda: self._times_of(ctx).to_dict())
        self._elapsed(ctx)
        await self._host.values.put(ctx.object("destination"), POSE, pose.stamped, f"{SYMBOL}.destination_valid")
        ctx.progress(f"pose {number} of {loop.poses} ({ctx.memory['pose']})", done)

    async def read_planned_pos(self, ctx: ActionContext) -> None:
        """The same of a destination to which a path was planned while the arm was at the pose before."""
        await self.read_next_pos(ctx)
        ctx.memory["planned"] = True

    async def way_known(self, ctx: ActionContext) -> dict[str, object]:
        """Whether the path to the next destination is known already; the first one is sought from home.

        Poses in another order than listed are reached by their joints, wherever the arm comes from.

        Each further configuration is near to the one before: so they are the same wherever the arm was at first, and
        the light is as free in all of them as when the poses were chosen.
        """
        visits = Visits(ctx)
        loop = visits.loop
        known = {"planned": ctx.memory["planned"], "near": "home" if loop.taken == 1 else "here"}
        if not visits.as_listed and loop.present is not None:
            file = await self._poses(ctx)
            known |= {
                "destination": "",
                "joints": list(file.poses[visits.pose_of(loop.present.number) - 1].joints or ()),
            }
        return known

    async def next_destination(self, ctx: ActionContext) -> dict[str, object]:
        """Where the arm goes from here, and where the path to there is to lie."""
        visits = Visits(ctx)
        pose = (await self._poses(ctx)).poses[visits.pose_of(visits.loop.following) - 1]
        leaves = f"path/{ctx.request_arguments['group']}"
        if not visits.as_listed:
            return {"joints": list(pose.joints or ()), "leaves": leaves}
        await self._host.values.put(ctx.object("next_destination"), POSE, pose.stamped)
        return {"destination": "next_destination", "leaves": leaves}

    def present_look(self, ctx: ActionContext) -> dict[str, object]:
        """Return cameras, light and exposure of the present look, at the arm's present pose."""
        visits = Visits(ctx)
        loop = visits.loop
        visit = loop.look()
        visits.keep(loop)
        ctx.memory["looked"] = ctx.memory["pose"]
        if visits.for_accuracy:
            ctx.memory["there"] = visits.pose_of(visit.number)
        return {**self.watchers(ctx), "longer": visit.longer}

    def watchers(self, ctx: ActionContext) -> dict[str, object]:
        """Return the cameras and the light, or the target, of the last look."""
        return {name: ctx.memory[name] for name in ("cameras", "light", "target")}

    def looked_pose(self, ctx: ActionContext) -> dict[str, object]:
        """Return the pose of the spots and the position to keep."""
        visits, pose = Visits(ctx), ctx.memory["looked"]
        loop = visits.loop
        ctx.memory.pop("taken_up", None)
        ctx.progress(f"pose {pose} observed", loop.looked_progress)
        return {"number": visits.observation_of(loop.looked_number), "pose": pose}

    async def visit_again(self, ctx: ActionContext) -> None:
        """Visit the last seen pose again, with more light after a faint spot."""
        visits = Visits(ctx)
        loop = visits.loop
        loop.give_back_looked(longer=ctx.failure is not None and ctx.failure.code == TOO_FAINT)
        visits.keep(loop)
        ctx.progress(f"pose {ctx.memory['looked']} is visited again: {_reason(ctx)}", loop.looked_progress)

    async def assess(self, ctx: ActionContext) -> None:
        """Compare the expected error with the accuracy asked for, and plan further visits after a miss."""
        await self._plan_visits(ctx)

    async def skip_pose(self, ctx: ActionContext) -> None:
        """Leave out the arm's present or coming pose, with the reason."""
        ctx.memory.pop("there", None)
        visits = Visits(ctx)
        if (present := visits.loop.present) is not None:
            visits.bar(present.number)
        await self._skip(ctx, str(ctx.memory["pose"]), visits.loop.progress)

    async def skip_look(self, ctx: ActionContext) -> None:
        """Leave out the last seen pose, with the reason."""
        visits = Visits(ctx)
        visits.bar(visits.loop.looked_number)
        await self._skip(ctx, str(ctx.memory["looked"]), visits.loop.looked_progress)

    async def take_up(self, ctx: ActionContext) -> None:
        """Give the present pose back, if there is one: the pose is visited again."""
        ctx.memory.pop("there", None)
        visits = Visits(ctx)
        loop = visits.loop
        loop.give_back()
        visits.keep(loop)
        ctx.memory["taken_up"] = _take_ups(ctx) + 1

    async def collected(self, ctx: ActionContext) -> dict[str, object]:
        """Return the input of the calibration: numbers of the observed poses, and reasons for the others."""
        skipped = await self._skipped(ctx)
        left_out = {skip["pose"] for skip in skipped}
        visits = Visits(ctx)
        names = visits.names(await self._poses(ctx))
        return {
            "cameras": ctx.memory["cameras"],
            "target": ctx.memory["target"],
            "observations": sorted(
                visits.observation_of(number) for number, name in enumerate(names, 1) if name not in left_out
            ),
            "rejected": {str(skip["pose"]): skip["reason"] for skip in skipped},
            # by its name: /vss may be on another host, with a folder of results of its own
            "directory": Path(str(ctx.memory["directory"])).name,
        }

    async def write_report(self, ctx: ActionContext) -> None:
        """Write the report of a successful calibration."""
        told = await self._host.values.read(ctx.object("calibration"), REPORT, [("json",)])
        solver = read_json(dict[str, object], str(told["json"]), "the report of the calibration")
        visits = Visits(ctx)
        poses = visits.loop.poses
        report = succeeded(solver, await self._skipped(ctx), poses)
        if visits.for_accuracy:
            report["accuracy"] = reached = accuracy_reached(solver, visits.asked_m, visits.planned)
            if not reached["reached"]:
                ctx.result["message"] = reached["message"]
        await self._expect(poses)
        ctx.result.update(self._finish(ctx, report))

    async def note_left(self, ctx: ActionContext) -> None:
        """Note in the result of a good calibration a cell left in another state than found."""
        told = ctx.result.get("message")
        before = f"{told};" if told else "the cell is not left as it was found:"
        ctx.result["message"] = f"{before} {_reason(ctx)}"

    async def note_failure(self, ctx: ActionContext) -> None:
        """Keep the reason of the command's end, before the closing steps can fail too."""
        reason = "the command was cancelled" if ctx.cancelled else _reason(ctx)
        ctx.memory["reason"] = reason
        ctx.progress(f"{'establishing again' if _begun_anew(ctx) else 'giving up'}: {reason}")

    async def note_unkept(self, ctx: ActionContext) -> None:
        """Keep the reason, and note the lost look: after a resume the pose is visited again."""
        visits = Visits(ctx)
        loop = visits.loop
        loop.give_back_looked()
        visits.keep(loop)
        await self.note_failure(ctx)

    async def report_failure(self, ctx: ActionContext) -> None:
        """Write the report of a failed command, and its observations."""
        reason = str(ctx.memory.get("reason") or _reason(ctx))
        ctx.result["message"] = reason
        self._expected = None
        if "loop" in ctx.memory:
            skipped: list[Mapping[str, object]] = []
            with contextlib.suppress(ImError):  # the data objects may be what failed
                skipped = await self._skipped(ctx)
                await self._keep_observations(ctx)
            try:
                self._finish(ctx, failed(reason, skipped))
            except StoreError as error:  # the command ends all the same, and says both
                ctx.result["message"] = f"{reason}; there is no report: {error.message}"

    # What they share.

    async def _skip(self, ctx: ActionContext, pose: str, progress: float) -> None:
        visits, reason = Visits(ctx), _reason(ctx)
        loop = visits.loop
        await self._host.values.put(ctx.object(f"skipped/{loop.skip()}"), REJECTION, {"pose": pose, "reason": reason})
        visits.keep(loop)
        if _all_planned_taken(ctx):
            await self._plan_visits(ctx)
        ctx.progress(f"pose {pose} skipped: {reason}", progress)

    async def _plan_visits(self, ctx: ActionContext) -> None:
        """Add the next visits to a command with an accuracy, if any is needed and left."""
        visits, file = Visits(ctx), await self._poses(ctx)
        left_out = {skip["pose"] for skip in await self._skipped(ctx)}
        observed: dict[int, list[Mapping[str, object]]] = {}
        coming = []
        for number, (name, pose) in enumerate(zip(visits.names(file), visits.planned, strict=True), 1):
            if name in left_out:
                continue
            if (seen := await self._observation(ctx, number)) is None:
                coming.append(pose)
            else:
                observed.setdefault(pose, []).append(seen)
        question = file, ctx.memory["cameras"], visits.asked_m, observed, coming, visits.barred
        added, expected = await self._host.noted_apart("visits", _next_visits, *question)
        loop = visits.add(added)
        if expected is not None:
            ctx.progress(f"{1e3 * expected:.3f} mm expected of {1e3 * visits.asked_m:g} mm", loop.progress)

    async def _poses(self, ctx: ActionContext) -> PosesFile:
        """Return the poses of a command; read the file again after a restart or in a recording."""
        if self._file is None or self._file[0] != ctx.command.id or self._host.recorded:
            told = await self._host.values.read(ctx.object(POSES), TEXT, [("data",)])
            self._file = ctx.command.id, read_json(PosesFile, str(told["data"]), "the poses of the calibration")
        return self._file[1]

    async def _skipped(self, ctx: ActionContext) -> list[Mapping[str, object]]:
        counts = range(1, Visits(ctx).loop.skipped + 1)
        return [await self._host.values.read(ctx.object(f"skipped/{count}"), REJECTION, [()]) for count in counts]

    async def _observation(self, ctx: ActionContext, number: int) -> Mapping[str, object] | None:
        """Return an observation of the command; None if there is none."""
        try:
            return await self._host.values.read(ctx.object(f"observation/{number}"), OBSERVATION, [()])
        except ImError as error:  # as told by the DOM: the class is lost on the way
            if error.code != NotFoundError.default_code:
                raise
            return None

    async def _keep_observations(self, ctx: ActionContext) -> None:
        """Write the observations so far, if any, in the format of a calibration."""
        visits = Visits(ctx)
        numbers = sorted(visits.observation_of(number) for number in range(1, visits.loop.taken + 1))
        kept = [await self._observation(ctx, number) for number in numbers]
        if observed := [seen for seen in kept if seen is not None]:
            told = str(ctx.memory["directory"]), ctx.memory["cameras"], str(ctx.memory["target"]), observed
            await self._host.noted_apart("observations", _write_observations, *told)

    async def _expect(self, poses: int) -> None:
        """Compute the expected duration of the command, where the nets give one."""

        def compute() -> None:
            self._expected = expectation(self._times.nets(), SYMBOL, poses)

        self._expected = None
        try:
            await self._host.noted_apart("expected", compute)
        except ImError as error:
            self._host.warn(f"no duration is expected: {error.message}")

    def _finish(self, ctx: ActionContext, report: dict[str, object]) -> dict[str, object]:
        elapsed_s, simulated_s = self._elapsed(ctx)
        directory = str(ctx.memory["directory"])

        def timing() -> dict[str, object]:
            times = self._times_of(ctx)
            summary = times.summary(elapsed_s, simulated_s)
            if self._expected is not None:
                summary["expectation"] = beside(self._expected, times.steps, simulated_s)
            return summary

        seed = self._host.noted("seed", lambda: self._host.parameter("seed"))
        report = {
            **report,
            "light": ctx.memory["light"],
            "board": ctx.memory["target"],
            "timing": self._host.noted("timing", timing),
            "seed": seed,
        }
        self._host.noted("report", lambda: str(write_report(Path(directory), report)))
        return {"report": report, "directory": directory}

    def _elapsed(self, ctx: ActionContext) -> tuple[float, float]:
        """Return wall and testbed time since the command began [s], without the time of a dead machine.

        Raises:
            StateError: None has begun.
        """
        match ctx.memory:
            case {"begun_ms": [int(), int()] as begun, "seen_ms": [int(), int()] as seen}:
                now = self._clocks_ms()
            case _:
                raise StateError("no calibrate_camera command is running")
        # a clock that is before where it was seen last is another one, of the next incarnation of computer or testbed
        shifts = [min(0, after - before) for after, before in zip(now, seen, strict=True)]
        begun = [start + shift for start, shift in zip(begun, shifts, strict=True)]
        ctx.memory["begun_ms"], ctx.memory["seen_ms"] = begun, now
        return (now[0] - begun[0]) / 1000.0, (now[1] - begun[1]) / 1000.0

    def _clocks_ms(self) -> list[int]:
        return self._host.noted(
            "clocks_ms", lambda: [round(1000.0 * clock.monotonic()), round(1000.0 * self._times.now())]
        )

    def _times_of(self, ctx: ActionContext) -> StepTimes:
        """Return the times of a command; after a restart, continue the times of the former incarnation."""
        if self._times.command != ctx.command.id:
            self._times.command = ctx.command.id
            self._times.add_times(ctx.memory.get("times"))
        return self._times


def _poses_text(path: str, target: str) -> str:
    return load_named_poses(path, target).model_dump_json()


def _write_observations(directory: str, cameras: list[str], target: str, observed: list[Mapping[str, object]]) -> str:
    content = dataset_of_command(cameras, target, [observation_of(_as_message(each)) for each in observed])
    return str(write_observations(directory, content))


def _as_message(fields: Mapping[str, object]) -> Any:
    return json.loads(json.dumps(fields), object_hook=lambda each: SimpleNamespace(**each))


def _new_directory() -> str:
    return str(make_directory(results_dir(), clock.stamp_name()))


def _other_needed(ctx: ActionContext) -> bool:
    return bool(ctx.memory["other"])


def _more_poses(ctx: ActionContext) -> bool:
    return Visits(ctx).loop.more_poses()


def _goes_on(ctx: ActionContext) -> bool:
    return _more_poses(ctx) and not ctx.cancelled


def _plans_ahead(ctx: ActionContext) -> bool:
    """Return whether the arm goes on, and to another pose."""
    visits = Visits(ctx)
    return _goes_on(ctx) and ctx.memory.get("there") != visits.pose_of(visits.loop.following)


def _stays(ctx: ActionContext) -> bool:
    """Return whether the arm is at the destination already: a further look of the same visit."""
    visits = Visits(ctx)
    present = visits.loop.present
    return "there" in ctx.memory and present is not None and ctx.memory["there"] == visits.pose_of(present.number)


def _all_planned_taken(ctx: ActionContext) -> bool:
    """Return whether an accuracy is asked for, and all visits planned for it have begun."""
    return Visits(ctx).for_accuracy and not _more_poses(ctx)


def _order_wanted(ctx: ActionContext) -> bool:
    """Return whether the poses may be visited in any order, and none is known yet."""
    return bool(ctx.memory["free"]) and Visits(ctx).order_found is None


def _next_visits(
    file: PosesFile,
    cameras: list[str],
    accuracy_m: float,
    observed: Mapping[int, list[Mapping[str, object]]],
    coming: list[int],
    barred: list[int],
) -> tuple[list[int], float | None]:
    seen = {pose: [observation_of(_as_message(each)) for each in looks] for pose, looks in observed.items()}
    found = next_visits(file, cameras, accuracy_m, seen, coming, barred)
    return list(found.poses), found.expected_m


def _another_visit_may_help(ctx: ActionContext) -> bool:
    """Return whether a light was too faint for the first time, or the images died with the process."""
    code, looked = ctx.failure.code if ctx.failure is not None else "", Visits(ctx).loop.looked
    return code == FORGOTTEN or (code == TOO_FAINT and looked is not None and not looked.longer)


def _dispensable(ctx: ActionContext) -> bool:
    return ctx.failure is not None and Visits(ctx).loop.dispensable(ctx.failure.code)


def _begun_anew(ctx: ActionContext) -> bool:
    """Return whether a lost establishment can be mended by another one."""
    gone = ctx.last_failure is not None and ctx.last_failure.code == BEGUN_ANEW
    return gone and not ctx.cancelled and _take_ups(ctx) < MOST_TAKE_UPS


def _take_ups(ctx: ActionContext) -> int:
    return int(str(ctx.memory.get("taken_up", 0)))


def _reason(ctx: ActionContext) -> str:
    """Return the reason of the token's place; without one, the last failure of the command."""
    failure = ctx.failure or ctx.last_failure
    return "nobody says why" if failure is None else failure.message


def _standing(command: Job) -> str:
    if "loop" not in command.memory:
        return "begun"
    loop = PoseLoop.from_json(command.memory["loop"])
    return f"pose {loop.taken} of {loop.poses}"


COMMAND = CommandDescription(
    net=Path(__file__).parent.parent / "nets/calibrate_camera.yaml",
    functions=lambda host, times: CalibrateCamera(host, times).functions,
    standing={SYMBOL: _standing},
)
