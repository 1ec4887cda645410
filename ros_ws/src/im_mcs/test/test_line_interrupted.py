"""Whatever happens to a straight line on the way, the tool stays on it."""

import numpy as np
import pinocchio as pin
import pytest

WAY = np.array([0.0, 0.4, 0.0])
OFF_M, OFF_RAD = 5e-5, 2e-4


class Tool:
    """The left wrist on a line, judged in every tick.

    Attributes:
        share: Of the line that has been passed, tick by tick.
    """

    def __init__(self, bench, model, cell):
        self.bench, self.model = bench, model
        bench.to_motion("left")
        first = cell.home[:9].copy()
        first[7] = 0.8
        assert bench.move("left", first)["success"]
        self.start, self.way, self.share = self.pose(), WAY, []

    def pose(self):
        q = self.bench.mcs.measured.q.copy()
        q[:9] = self.bench.mcs.groups["left"].planner.setpoint.q
        return self.model.pose(q, "left_wrist")

    def line(self, way, policy="refuse"):
        self.way = way
        target = self.start.translation + way
        pose = [*target.tolist(), *pin.Quaternion(self.start.rotation).coeffs().tolist()]
        path = {"kind": "line", "poses": [pose], "speed": 0.25}
        return self.bench.send("move", group="left", path=path, policy=policy)

    def tick(self, count=1):
        for _ in range(count):
            self.bench.mcs.tick([])
            self.judge()

    def judge(self):
        pose = self.pose()
        moved = pose.translation - self.start.translation
        self.share.append(moved @ self.way / (self.way @ self.way))
        assert np.linalg.norm(moved - self.share[-1] * self.way) < OFF_M
        assert np.linalg.norm(pin.log3(pose.rotation @ self.start.rotation.T)) < OFF_RAD
        assert np.diff(self.share[-2:], prepend=0.0).min() > -1e-6  # never back

    def order(self, request, **given):
        reply = self.bench.reply(self.bench.send(request, **given))
        assert reply["success"], reply
        self.judge()

    def until(self, condition):
        for _ in range(4000):
            if condition():
                return
            self.tick()
        raise AssertionError("it never comes")

    @property
    def still(self):
        return self.bench.mcs.groups["left"].planner.still

    def ended(self, number):
        self.until(lambda: self.bench.reply(number) is not None)
        return self.bench.reply(number)


@pytest.fixture
def tool(bench, model, cell):
    return Tool(bench, model, cell)


HOLDS = {
    "pause": {"group": "left"},
    "protective_stop": {"reason": "a hand"},
}


@pytest.mark.parametrize("hold", HOLDS)
@pytest.mark.parametrize("after", [100, 200, 330])
def test_a_line_that_is_held_and_resumed_is_the_same_line(tool, hold, after):
    number = tool.line(WAY)
    tool.tick(after)
    tool.order(hold, **HOLDS[hold])
    tool.until(lambda: tool.still)
    assert 0.0 < tool.share[-1] < 1.0
    tool.order("set_speed", group="left", scale=0.4)
    tool.order("resume", group="left")
    tool.tick(100)
    tool.order("set_speed", group="left", scale=1.0)
    assert tool.ended(number)["success"]
    assert tool.share[-1] == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("after", [100, 200, 330])
def test_a_cancelled_line_ends_on_the_line(tool, after):
    number = tool.line(WAY)
    tool.tick(after)
    tool.order("cancel", goal=number)
    assert tool.ended(number)["error"]["code"] == "cancelled"
    assert 0.0 < tool.share[-1] < 1.0
    assert tool.still


def test_a_line_that_replaces_a_line_begins_where_that_one_stops(tool):
    first = tool.line(WAY)
    tool.tick(150)
    second = tool.line(WAY, policy="replace")
    assert tool.ended(first)["error"]["code"] == "replaced"
    stopped = tool.share[-1]
    assert 0.0 < stopped < 1.0
    assert tool.ended(second)["success"]
    assert tool.share[-1] == pytest.approx(1.0, abs=1e-5)


def test_a_protective_stop_that_nobody_resumes_ends_the_line_where_it_holds(tool):
    number = tool.line(WAY)
    tool.tick(150)
    tool.order("protective_stop", reason="a hand")
    reply = tool.ended(number)
    assert "a hand" in reply["error"]["message"]
    assert 0.0 < tool.share[-1] < 1.0
    held = tool.pose().translation
    tool.tick(20)
    np.testing.assert_allclose(tool.pose().translation, held, atol=1e-9)
