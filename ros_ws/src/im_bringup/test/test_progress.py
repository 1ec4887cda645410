from im_bringup.calibration.progress import FiringPhase, ProgressLines

START, END, FAILED, CANCEL, DOUBT = FiringPhase


def told(*firings):
    lines = ProgressLines()
    return [line for firing in firings if (line := lines.line(*firing)) is not None]


def both(transition, fraction, seconds):
    return [(transition, START, "", fraction, 0.0), (transition, END, "", fraction, seconds)]


def test_steps_outside_the_loop_have_a_line_each_and_a_pose_has_one():
    assert told(
        *both("light_on", -1.0, 0.1),
        *both("read_first_pos", 0.0, 0.0),
        *both("move_robot", 0.0, 0.5),
        ("begin_pose", END, "", 0.0, 0.0),
        *both("look", 0.0, 0.01),
        *both("read_next_pos", 0.025, 0.0),
        ("move_robot", START, "", 0.025, 0.0),
        *both("find_spot", 0.025, 0.25),
        *both("keep_observation", 0.025, 0.0),
        ("move_robot", END, "", 0.025, 0.75),
        ("stay", END, "", 0.025, 0.0),
        *both("keep_observation", 0.05, 0.0),
        ("loop_done", END, "", 0.05, 0.0),
        *both("compute_calibration", 1.0, 2.0),
    ) == [
        "[  - %] light_on",
        "[  2 %] pose 1 of 40: move_robot 0.50 s, look 0.01 s, find_spot 0.25 s",
        "[  5 %] pose 2 of 40: move_robot 0.75 s",
        "[100 %] compute_calibration",
    ]


def test_failures_are_told_with_their_reason():
    assert told(
        *both("read_first_pos", 0.0, 0.0),
        ("move_robot", START, "", 0.0, 0.0),
        ("move_robot", FAILED, "left_j3: out of reach", 0.0, 1.0),
        *both("skip_unreached", 0.5, 0.0),
        ("skip_done", END, "", 0.5, 0.0),
        ("compute_calibration", START, "", 1.0, 0.0),
        ("compute_calibration", FAILED, "too few poses", 1.0, 1.0),
    ) == [
        "[ 50 %] pose 1 of 2: move_robot failed: left_j3: out of reach",
        "[100 %] compute_calibration",
        "[100 %] compute_calibration failed: too few poses",
    ]


def test_an_observation_that_cannot_be_used_is_told_with_its_pose():
    assert told(
        *both("read_first_pos", 0.0, 0.0),
        *both("read_next_pos", 0.0, 0.0),
        ("move_robot", START, "", 0.0, 0.0),
        ("keep_observation", START, "", 0.5, 0.0),
        ("keep_observation", FAILED, "the image is older than the rest", 0.5, 0.1),
        *both("skip_unusable", 0.5, 0.0),
    ) == ["[ 50 %] pose 1 of 2: keep_observation failed: the image is older than the rest"]


def test_a_pose_that_cannot_be_read_is_told_with_the_one_before():
    assert told(
        *both("read_first_pos", 0.0, 0.0),
        ("read_next_pos", START, "", 0.0, 0.0),
        ("read_next_pos", FAILED, "dom is missing", 0.0, 0.0),
        *both("abort_unread", 0.0, 0.0),
        *both("abort_light_off", 0.0, 0.1),
    ) == ["[  0 %] pose 1: read_next_pos failed: dom is missing", "[  0 %] abort_light_off"]


def test_an_abort_ends_both_poses():
    assert told(
        *both("read_first_pos", 0.0, 0.0),
        *both("read_next_pos", 0.025, 0.0),
        *both("keep_observation", 0.025, 0.0),
        *both("read_next_pos", 0.025, 0.0),
        *both("move_robot", 0.025, 0.5),
        ("find_spot", FAILED, "vss is missing", 0.025, 6.0),
        *both("abort_unseen", 0.025, 0.0),
        ("abort_arrived", END, "", 0.025, 0.0),
        *both("abort_light_off", 0.025, 0.1),
    ) == [
        "[  2 %] pose 1 of 40: ",
        "[  2 %] pose 2 of 40: find_spot failed: vss is missing",
        "[  2 %] pose 3 of 40: move_robot 0.50 s",
        "[  2 %] abort_light_off",
    ]
    assert told(
        *both("read_first_pos", 0.0, 0.0),
        ("move_robot", FAILED, "e-stop", 0.0, 1.0),
        *both("abort_unreached", 0.0, 0.0),
        *both("abort_light_off", 0.0, 0.1),
    ) == ["[  0 %] pose 1: move_robot failed: e-stop", "[  0 %] abort_light_off"]


def test_a_doubt_is_told_at_once_and_a_cancellation_when_it_has_ended():
    assert told(
        ("read_first_pos", START, "", 0.0, 0.0),
        ("move_robot", CANCEL, "", 0.0, 0.0),
        ("move_robot", DOUBT, "its process ended", 0.0, 0.0),
    ) == ["[  0 %] move_robot is in doubt: its process ended"]
