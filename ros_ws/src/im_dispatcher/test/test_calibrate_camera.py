"""The functions of calibrate_camera, played without ROS and without a net."""

import asyncio
import json
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace

import pytest

from im_calibration import load_problems
from im_cell.robot import load_cell
from im_core.errors import BEGUN_ANEW, DataError, ImError, LinkError, NotFoundError, StateError
from im_dispatcher.accuracy import FIRST_POSES, LOOKS
from im_dispatcher.commands.calibrate_camera import COMMAND, MOST_TAKE_UPS, SYMBOL, CalibrateCamera
from im_dispatcher.poses_file import WristPose, load_named_poses
from im_dispatcher.report import StepTimes
from im_pnt.errors import JournalError, NetError
from im_pnt.execution.functions import ActionContext
from im_pnt.execution.jobs import Command, Job, Lineage


class Host:
    """Keeps data objects in memory, and counts who asks for them."""

    recorded = False

    def __init__(self) -> None:
        self.values, self.objects = self, {}
        self.calls: list[str] = []
        self.dead = False

    async def put(self, name: str, kind: str, fields: Mapping[str, object], place: str = "") -> None:
        self._called(name)
        self.objects[name] = kind, fields

    async def read(self, name: str, kind: str, ways: object) -> object:
        self._called(name)
        if name not in self.objects:
            error = NotFoundError(kind="data object", name=name)
            raise ImError(error.message, code=error.code)  # as the DOM's answer comes: its class is lost on the way
        assert self.objects[name][0] == kind
        return self.objects[name][1]

    def _called(self, name: str) -> None:
        if self.dead:
            raise LinkError("/dom is dead")
        self.calls.append(name)

    def noted(self, key: str, compute):
        return compute()

    async def noted_apart(self, key: str, compute, *arguments: object) -> object:
        return compute(*arguments)

    def parameter(self, name: str) -> object:
        return {"seed": 3}[name]

    def warn(self, text: str) -> None:
        pass


def no_nets() -> object:
    raise NetError("no nets here")


class Play:
    """One command, whose dispatcher may die between two functions."""

    def __init__(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("IM_RESULTS_DIR", str(tmp_path))
        self.host, self.now = Host(), lambda: 7.0
        arguments: dict[str, object] = {"cameras": [], "poses_file": "", "group": "left"}
        self.job = Job(Command(1, SYMBOL, arguments), arguments)
        self._poses = load_named_poses("").poses
        self.restart()

    def restart(self) -> None:
        self.job.memory = json.loads(json.dumps(self.job.memory))
        self._made = CalibrateCamera(self.host, StepTimes(no_nets, lambda: self.now())).functions

    def __call__(self, name: str, failure: ImError | None = None, **given: object) -> object:
        outcome = self._made.actions[name](
            ActionContext(SYMBOL, name, Lineage(self.job, failure), shared={"calibration"}), **given
        )
        return asyncio.run(outcome) if asyncio.iscoroutine(outcome) else outcome

    def guard(self, name: str) -> Callable[[ImError], bool]:
        """An enabling function, of the failure that has put a token on an input place."""
        judge = self._made.guards[name]
        return lambda failure: judge(ActionContext(SYMBOL, name, Lineage(self.job, failure), shared=set()))

    def pose(self) -> str:
        """Takes the next pose; returns where it leads."""
        self("read_next_pos")
        return self.place("destination")

    def place(self, destination: str) -> str:
        """The name of the pose of the file where a destination is."""
        kind, fields = self.host.objects[f"{SYMBOL}/1/{destination}"]
        assert (kind, fields["header"]) == ("geometry_msgs/msg/PoseStamped", {"frame_id": "world"})
        (name,) = (pose.name for pose in self._poses if pose.stamped == fields)
        return name


@pytest.fixture
def accurate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Play:
    """A command with an accuracy, begun."""
    play = Play(tmp_path, monkeypatch)
    play.job.command.arguments["accuracy"] = 3e-4
    play("init_calib")
    return play


def test_an_accuracy_is_reached_by_several_looks_at_poses_that_are_reached_by_their_joints(accurate: Play) -> None:
    stays, planned, taken = (accurate.guard(name) for name in ("stays", "plans_ahead", "all_planned_taken"))
    names = []
    for look in range(LOOKS + 1):
        names.append(accurate.pose())
        assert stays(None) is (0 < look < LOOKS), "the arm is there for all looks of a visit"
        way = accurate("way_known")
        assert (way["destination"], way["joints"]) == ("", list(_pose_named(names[-1]).joints))
        accurate("present_look")
        assert planned(None) is (look == LOOKS - 1), "a path is planned to another pose alone"
        accurate.restart()
    first, other = names[0], names[-1]
    assert names == [first] * LOOKS + [other]
    assert first != other
    assert accurate("next_destination")["joints"] == list(_pose_named(other).joints)
    assert not taken(None)
    accurate("take_up", StateError("mcs has begun anew", code=BEGUN_ANEW))
    accurate.pose()
    assert not stays(None), "nobody knows where the arm is"


def test_a_pose_out_of_reach_loses_all_its_looks_and_others_are_planned_in_its_place(accurate: Play) -> None:
    name = accurate.pose()
    accurate("skip_pose", DataError("out of reach"))
    names = [accurate.pose() for _ in range(LOOKS * (FIRST_POSES - 1))]
    assert name not in names
    assert accurate.guard("all_planned_taken")(None)
    accurate("assess")
    assert not accurate.guard("all_planned_taken")(None), "nothing was observed: more is planned"
    rejected = accurate("collected")["rejected"]
    assert rejected == {f"{name}/1": "out of reach"}


def test_a_report_says_where_the_poses_have_run_out(accurate: Play) -> None:
    accurate.pose()
    solver = {"success": True, "points_rejected": [], "expected_error": {"triangulation_mm": 0.4}}
    accurate.host.objects["calibration"] = "im_msgs/msg/CalibrationReport", {"json": json.dumps(solver)}
    accurate("write_report")
    said = "an error of 0.400 mm is expected, 0.3 mm was asked for: the poses have run out"
    assert accurate.job.results["message"] == said
    assert accurate.job.results["report"]["accuracy"]["reached"] is False


def _pose_named(name: str) -> WristPose:
    return next(pose for pose in load_named_poses("").poses if pose.name == name)


@pytest.fixture
def play(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Play:
    play = Play(tmp_path, monkeypatch)
    play("init_calib")
    return play


def test_nothing_moves_where_the_other_arm_is_in_the_way(play: Play) -> None:
    assert play.guard("other_needed")(None)
    assert play("other_arm") == {"group": "right"}
    home = list(load_cell().groups["right"].home)
    there = SimpleNamespace(state=SimpleNamespace(joints=[f"right_{number}" for number in range(9)], q=home))
    play("require_other", answer=there)
    home[0] -= 0.5
    with pytest.raises(StateError, match=r"right_0 is at 1\.050, not 1\.550"):
        play("require_other", answer=there)


def test_a_command_begins_with_its_poses_and_its_light(play: Play) -> None:
    seen = {"cameras": ["ceiling_left", "ceiling_right"], "light": "left_led", "target": ""}
    assert play("watchers") == seen
    play.pose()
    assert play("present_look") == {**seen, "longer": False}


def test_a_pose_costs_one_call_and_no_more_memory_than_the_one_before(play: Play) -> None:
    sizes, name = [], play.pose()
    for number in range(1, 41):
        before, seen = len(play.host.calls), name
        play("present_look")
        if number < 40:  # the arm goes on before the images are searched
            name = play.pose()
            assert play.host.calls[before:] == [f"{SYMBOL}/1/destination"]
        assert play("looked_pose") == {"number": number, "pose": seen}
        sizes.append(len(json.dumps(play.job.memory)))
    assert max(sizes[9:]) == min(sizes[9:])
    assert COMMAND.standing[SYMBOL](play.job) == "pose 40 of 40"
    with pytest.raises(DataError, match="all poses have been visited"):
        play.pose()


def test_the_poses_are_read_again_while_the_mission_is_recorded_for_it_may_have_begun_before(play: Play) -> None:
    play.pose()
    play.host.calls.clear()
    play.host.recorded = True
    play.pose()
    play("next_destination")
    assert play.host.calls.count(f"{SYMBOL}/1/calibration_poses") == 2


def test_the_arm_takes_the_path_that_was_planned_while_it_was_at_the_pose_before(play: Play) -> None:
    play.pose()
    assert play("way_known") == {"planned": False, "near": "home"}, "wherever the arm is at first"
    play("present_look")
    assert play("next_destination") == {"destination": "next_destination", "leaves": "path/left"}
    assert play.place("next_destination") == "p02"
    play.restart()
    play("read_planned_pos")
    assert play.place("destination") == "p02"
    assert play("way_known") == {"planned": True, "near": "here"}
    play("present_look")
    play("next_destination")  # no path is found
    assert play.pose() == "p03"
    assert play("way_known") == {"planned": False, "near": "here"}


def test_a_pose_whose_light_is_too_faint_is_visited_once_more_and_exposed_longer(play: Play) -> None:
    faint, may_help = ImError("too faint", code="spot_too_faint"), play.guard("another_visit_may_help")
    play.pose()
    play("present_look")
    names = [play.pose()]
    assert may_help(faint)
    play("visit_again", faint)
    assert play("present_look")["longer"] is False
    names.append(play.pose())
    assert play("present_look")["longer"] is True
    assert not may_help(faint)
    assert may_help(ImError("gone", code="look_forgotten"))
    assert not may_help(ImError("hidden", code="spot_not_found"))
    play("skip_look", faint)
    names.append(play.pose())
    assert names == ["p02", "p01", "p03"]
    skipped = "im_msgs/msg/Rejection", {"pose": "p01", "reason": "too faint"}
    assert play.host.objects[f"{SYMBOL}/1/skipped/1"] == skipped


@pytest.mark.parametrize("deaths", [(), (1, 20, 39), tuple(range(40))])
def test_every_pose_is_visited_once_and_what_was_skipped_is_known_in_the_end(play: Play, deaths: tuple) -> None:
    names = []
    for number in range(40):
        if number in deaths:
            play.restart()
        names.append(play.pose())
        if number in (2, 30):
            play("skip_pose", DataError(f"reason {number}"))
    assert names == [f"p{number:02}" for number in range(1, 41)]
    collected = play("collected")
    assert collected["observations"] == [number for number in range(1, 41) if number not in (3, 31)]
    assert collected["rejected"] == {"p03": "reason 2", "p31": "reason 30"}
    solver = {"success": True, "points_rejected": []}
    play.host.objects["calibration"] = "im_msgs/msg/CalibrationReport", {"json": json.dumps(solver)}
    play("write_report")
    directory = Path(str(play.job.memory["directory"]))
    assert collected["directory"] == directory.name
    report = json.loads((directory / "report.json").read_text())
    assert [entry["pose"] for entry in report["points_rejected"]] == ["p03", "p31"]
    assert (report["seed"], report["poses"]) == (3, 40)


ORDER = [3, 1, 2, *range(4, 41)]


@pytest.fixture
def free(play: Play) -> Play:
    """A command whose poses were ordered."""
    assert play.guard("order_wanted")(None)
    assert play("poses_to_order") == {"positions": "positions"}
    kind, fields = play.host.objects[f"{SYMBOL}/1/positions"]
    assert kind == "trajectory_msgs/msg/JointTrajectory"
    assert fields["joint_names"] == list(load_cell().joints_of("left"))
    assert [tuple(point["positions"]) for point in fields["points"]] == [
        pose.joints for pose in load_named_poses("").poses
    ]
    play.job.replies["order_poses"] = {"order": ORDER}
    assert not play.guard("order_wanted")(None)
    return play


def test_poses_in_free_order_are_reached_by_their_joints_and_keep_their_numbers_in_the_file(free: Play) -> None:
    for number, name in ((3, "p03"), (1, "p01"), (2, "p02")):
        assert free.pose() == name
        way = free("way_known")
        assert (way["destination"], way["joints"]) == ("", list(_pose_named(name).joints))
        assert not free.guard("stays")(None)
        free("present_look")
        assert free("looked_pose") == {"number": number, "pose": name}
        free.restart()
    assert free("next_destination") == {"joints": list(_pose_named("p04").joints), "leaves": "path/left"}


def test_of_poses_in_free_order_the_same_are_left_out_and_kept_as_of_listed_ones(free: Play) -> None:
    names = []
    for visit in range(40):
        names.append(free.pose())
        if visit == 1:
            free("skip_pose", DataError("hidden"))
        else:
            number = ORDER[visit]
            free.host.objects[f"{SYMBOL}/1/observation/{number}"] = "im_msgs/msg/Observation", observed(number)
    assert names == [f"p{number:02}" for number in ORDER]
    collected = free("collected")
    assert collected["observations"] == list(range(2, 41))
    assert collected["rejected"] == {"p01": "hidden"}
    free("note_failure", LinkError("the arm is gone"))
    free("report_failure")
    (problem,) = load_problems(Path(str(free.job.memory["directory"])) / "observations.json")
    assert problem.pose_names == tuple(f"p{number:02}" for number in range(2, 41))


def test_poses_without_an_order_are_visited_as_listed(play: Play) -> None:
    play("note_listed", LinkError("the coordinator is gone"))
    assert not play.guard("order_wanted")(None)
    assert play.pose() == "p01"
    assert play("way_known") == {"planned": False, "near": "home"}


def test_a_pose_in_doubt_is_visited_again_and_one_that_was_not_begun_is_not_given_back(play: Play) -> None:
    play.pose()
    names = [play.pose()]
    for _ in range(2):  # the second death comes before the pose is begun again
        play.restart()
        play("take_up", StateError("mcs has begun anew", code=BEGUN_ANEW))
    names += [play.pose(), play.pose()]
    assert names == ["p02", "p02", "p03"]
    play("present_look")
    play.pose()
    play("note_unkept", StateError("the light went out", code=BEGUN_ANEW))  # while the arm went on to the fourth
    play("take_up", StateError("the light went out", code=BEGUN_ANEW))
    assert [play.pose() for _ in range(3)] == ["p03", "p04", "p05"]


def test_what_is_gone_again_and_again_is_not_established_for_ever(play: Play) -> None:
    gone, may = StateError("mcs has begun anew", code=BEGUN_ANEW), play.guard("begun_anew")
    play.job.last_failure = gone
    play.pose()
    for _ in range(MOST_TAKE_UPS):
        assert may(gone)
        play("take_up", gone)
    assert not may(gone)
    play.pose()
    play("present_look")
    play("looked_pose")
    assert may(gone), "a pose was observed since"


def test_time_without_a_machine_counts_for_nothing(play: Play, monkeypatch: pytest.MonkeyPatch) -> None:
    play.now = lambda: 12.0
    play.pose()
    play.now = lambda: 1.0  # the testbed of the next incarnation began at 0, and the command goes on at 1 s
    play.pose()
    play.now = lambda: 4.0
    play("note_failure", LinkError("the arm is gone"))
    play("report_failure")
    report = json.loads((Path(str(play.job.memory["directory"])) / "report.json").read_text())
    assert report["timing"]["simulated_s"] == pytest.approx(12.0 - 7.0 + 4.0 - 1.0)


def test_a_command_fails_with_a_report_even_if_the_data_objects_are_what_failed(play: Play) -> None:
    play.pose()
    play("skip_pose", DataError("hidden"))
    play.host.dead = True
    play("note_failure", LinkError("the arm is gone"))
    play("report_failure")
    assert play.job.results == {"message": "the arm is gone"}
    report = json.loads((Path(str(play.job.memory["directory"])) / "report.json").read_text())
    assert (report["success"], report["message"]) == (False, "the arm is gone")
    assert f"{SYMBOL}/1/skipped/1" in play.host.objects


def observed(number: int) -> dict[str, object]:
    """The fields of an observation of the ceiling's left camera alone."""
    spot = {"camera": "ceiling_left", "u": 100.0 + number, "v": 50.0, "covariance": [0.01, 0.0, 0.0, 0.01]}
    spot |= {"found": True, "stamp": {"sec": number, "nanosec": 5}}
    wrist = {"position": {"x": 0.1 * number, "y": 0.0, "z": 1.0}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}}
    lost = {**spot, "camera": "ceiling_right", "found": False}
    return {
        "pose": f"p{number:02}",
        "wrist": wrist,
        "position_covariance": [0.0] * 9,
        "arm_jacobian": [],
        "spots": [spot, lost],
    }


def test_what_was_observed_before_a_failure_or_a_cancellation_is_kept(play: Play) -> None:
    for number in (1, 2, 3):
        play.pose()
        if number != 2:
            play.host.objects[f"{SYMBOL}/1/observation/{number}"] = "im_msgs/msg/Observation", observed(number)
    play("note_failure", LinkError("the arm is gone"))
    play("report_failure")
    (problem,) = load_problems(Path(str(play.job.memory["directory"])) / "observations.json")
    assert (problem.pose_names, problem.camera_names) == (("p01", "p03"), ("ceiling_left", "ceiling_right"))
    assert problem.spots[0].tolist() == [[101.0, 50.0], [103.0, 50.0]]
    assert not problem.detected[1].any()
    led = load_cell().led
    assert (problem.led_offset_nominal, problem.led_offset_prior_sd) == (led.offset, led.offset_prior_sd)


def test_a_command_whose_report_cannot_be_written_ends_and_says_both(play: Play) -> None:
    play.pose()
    shutil.rmtree(str(play.job.memory["directory"]))
    play("note_failure", LinkError("the arm is gone"))
    play("report_failure")
    message = str(play.job.results["message"])
    assert message.startswith("the arm is gone; there is no report: ")
    assert message.endswith("cannot be written: No such file or directory")


def test_a_command_whose_reason_could_not_be_noted_ends_with_what_failed_last(play: Play) -> None:
    """As on a full disk: the journal refused the action that was to note it, and no failure came with the token."""
    play.pose()
    play.job.last_failure = JournalError("the journal cannot be written: No space left on device", file="journal")
    play("report_failure")
    assert play.job.results == {"message": "the journal cannot be written: No space left on device"}


def test_a_light_that_stays_on_and_an_arm_that_stays_powered_are_both_told(play: Play) -> None:
    play("note_left", StateError("light left_led does not go out"))
    play.restart()
    play("note_left", StateError("left is held by pendant"))
    said = "the cell is not left as it was found: light left_led does not go out; left is held by pendant"
    assert play.job.results == {"message": said}
