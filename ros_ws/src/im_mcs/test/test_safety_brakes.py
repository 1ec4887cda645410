"""Power and brakes that do not obey, and brakes that move by themselves."""

import numpy as np
import pytest

from im_mcs.state import State

LEFT = slice(0, 9)
ORDER = [State.COLD, State.RESERVED, State.ACTIVE, State.MOTION]


def bring_to(bench, state):
    for request in ("reserve", "power_on", "enable_motion")[: ORDER.index(state)]:
        assert bench.ask(request, **({"group": "left"} if request == "reserve" else {}))["success"]


class Deaf:
    """Power and brakes that do what they want."""

    def __init__(self, driver, **overrides):
        self.driver, self.overrides = driver, overrides

    def __call__(self):
        return type(self.driver).read(self.driver)._replace(**self.overrides)


def test_power_that_does_not_come_is_given_up(bench):
    bring_to(bench, State.RESERVED)
    bench.driver.read = Deaf(bench.driver, power=False)
    reply = bench.ask("power_on")
    assert reply["error"]["code"] == "timeout"
    assert bench.mcs.manager.state is State.RESERVED
    assert not bench.driver.drive.power


def test_power_that_does_not_go_is_an_estop_that_cannot_be_reset(bench):
    bring_to(bench, State.ACTIVE)
    bench.driver.read = Deaf(bench.driver, power=True, brakes=np.ones(18, dtype=bool))
    reply = bench.ask("power_off")
    assert reply["error"]["code"] == "timeout"
    assert bench.mcs.manager.state is State.ESTOPPED
    assert "power is not obeyed" in bench.mcs.manager.cause
    assert "still reports power on" in bench.ask("reset")["error"]["message"]
    del bench.driver.read
    assert bench.ask("reset")["success"]


@pytest.mark.parametrize("obeys", [True, False])
def test_after_an_estop_time_goes_on_until_the_testbed_has_obeyed(bench, obeys):
    """Else what is shown would stay what it was; but not for ever."""
    bring_to(bench, State.MOTION)
    if not obeys:
        bench.driver.read = Deaf(bench.driver, power=True)
    bench.send("estop", reason="test")
    assert bench.mcs.wants_time
    ticks = 0
    while bench.mcs.wants_time:
        bench.mcs.tick([])
        ticks += 1
    servo = bench.mcs.config.servo
    assert ticks <= (2 if obeys else round(servo.answer_timeout_s / servo.period_s))
    assert bench.mcs.measured.power != obeys
    assert not bench.driver.drive.power


def test_brakes_that_do_not_release_hold_before_the_torque_leaves(bench):
    bring_to(bench, State.ACTIVE)
    stuck = np.zeros(18, dtype=bool)
    stuck[9:] = True
    stuck[3] = True
    bench.driver.read = Deaf(bench.driver, brakes=stuck)
    number = bench.send("enable_motion")
    while not bench.driver.drive.brakes[LEFT].all() or bench.mcs.measured.tick < 20:
        bench.mcs.tick([])
    bench.driver.read = Deaf(bench.driver, brakes=np.ones(18, dtype=bool))
    with_torque = 0
    while bench.mcs.wants_time:
        with_torque += bool(bench.mcs.tau.any())
        bench.mcs.tick([])
    assert bench.reply(number)["error"]["code"] == "timeout"
    assert with_torque >= bench.mcs.config.servo.brake_lead_ticks
    assert bench.mcs.manager.state is State.ACTIVE
    assert not bench.mcs.tau.any()
    assert bench.driver.drive.brakes.all()


def test_brakes_that_neither_release_nor_engage_are_an_estop(bench):
    bring_to(bench, State.ACTIVE)
    half = np.ones(18, dtype=bool)
    half[:3] = False
    bench.driver.read = Deaf(bench.driver, brakes=half)
    reply = bench.ask("enable_motion")
    assert reply["error"]["code"] == "timeout"
    assert bench.mcs.manager.state is State.ESTOPPED
    assert "brakes are not obeyed" in bench.mcs.manager.cause


def test_brakes_that_do_not_engage_leave_the_torque_on(bench, model, cell):
    bring_to(bench, State.MOTION)
    loose = np.ones(18, dtype=bool)
    loose[2] = False
    bench.driver.read = Deaf(bench.driver, brakes=loose)
    reply = bench.ask("disable_motion")
    assert reply["error"]["code"] == "timeout"
    assert bench.mcs.manager.state is State.MOTION
    bench.mcs.tick([])
    np.testing.assert_allclose(bench.mcs.tau[LEFT], model.gravity(cell.home)[LEFT], atol=2.0)
    del bench.driver.read
    assert bench.ask("disable_motion")["success"]


def test_a_brake_that_does_not_obey_is_named(bench):
    bring_to(bench, State.ACTIVE)
    stuck = np.ones(18, dtype=bool)
    stuck[:9] = [False, True] + [False] * 7
    number = bench.send("enable_motion")
    while bench.driver.drive.brakes[LEFT].all():
        bench.mcs.tick([])
    bench.driver.read = Deaf(bench.driver, brakes=stuck)
    while not bench.driver.drive.brakes[LEFT].all():
        bench.mcs.tick([])
    del bench.driver.read
    while bench.mcs.wants_time:
        bench.mcs.tick([])
    assert "the brakes to release, those of left_rotation, in vain" in bench.reply(number)["error"]["message"]
    assert bench.mcs.manager.state is State.ACTIVE


def read_brake(bench, joint, engaged):
    """From now on the testbed says that the brake of a joint is so."""

    def read():
        measured = type(bench.driver).read(bench.driver)
        brakes = measured.brakes.copy()
        brakes[joint] = engaged
        return measured._replace(brakes=brakes)

    bench.driver.read = read


@pytest.mark.parametrize(
    ("state", "joint", "words"),
    [
        (State.ACTIVE, 4, "the brake of left_j2 is open at tick"),  # of a reserved group
        (State.ACTIVE, 13, "the brake of right_j2 is open at tick"),  # of another
        (State.MOTION, 4, "the brake of left_j2 is engaged at tick"),
        (State.MOTION, 13, "the brake of right_j2 is open at tick"),
    ],
)
def test_a_brake_that_moves_by_itself_is_an_estop(bench, state, joint, words):
    bring_to(bench, state)
    bound = round(bench.mcs.config.safety.brake_s / bench.mcs.config.servo.period_s)
    read_brake(bench, joint, not bench.mcs.manager.brakes[joint])
    for _ in range(bound):
        bench.mcs.tick([])
    assert bench.mcs.manager.state is state
    del bench.driver.read
    bench.mcs.tick([])  # it was but a moment
    read_brake(bench, joint, not bench.mcs.manager.brakes[joint])
    for _ in range(bound + 1):
        assert bench.mcs.manager.state is state
        bench.mcs.tick([])
    assert bench.mcs.manager.state is State.ESTOPPED
    assert words in bench.mcs.manager.cause
    assert not bench.driver.drive.power
    assert bench.driver.drive.brakes.all()


def test_no_power_while_a_brake_is_open(bench):
    bring_to(bench, State.RESERVED)
    read_brake(bench, 2, engaged=False)
    assert (
        "power_on is refused: the testbed reports the brake open of left_tilt"
        in bench.ask("power_on")["error"]["message"]
    )
    assert bench.ask("estop", reason="test")["success"]
    assert "reset is refused: the testbed reports the brake open of left_tilt" in bench.ask("reset")["error"]["message"]
    del bench.driver.read
    assert bench.ask("reset")["success"]
    bench.to_motion("left")
