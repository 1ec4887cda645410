"""Functions of the user's in the servo of a running machine: one that hangs ends alone, and /mcs/rates says so."""

import itertools

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from im_cell.robot import load_cell
from im_core.ros import qos
from support.mcs_config import write_mcs_config

HOME = load_cell().home[:9]

FUNCTIONS = """
class Hangs:
    def __init__(self, setup):
        self.calls = 0

    def __call__(self, reading):
        self.calls += 1
        while self.calls > 20:
            pass


def count(setup):
    readings = []
    return readings.append
"""


@pytest.fixture
def client(tmp_path, monkeypatch, run_machine):
    (tmp_path / "functions_of_a_test.py").write_text(FUNCTIONS, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    config = write_mcs_config(
        tmp_path,
        functions={
            "hangs": {"function": "functions_of_a_test:Hangs", "budget_s": 0.2},
            "count": {"function": "functions_of_a_test:count", "every": 2, "budget_s": 60.0},
        },
        safety={"owner_silence_s": 60.0, "servo_silence_s": 60.0},
    )
    with run_machine(config) as client:
        yield client


def test_a_function_that_hangs_ends_and_the_arm_goes_on(client):
    told = client.listen(DiagnosticArray, "/mcs/rates", qos.LATCHED)
    client.to_motion()
    target = HOME + 0.1
    assert client.move(target).success

    def newest():
        return {status.name: status for status in told[-1].status} if told else {}

    client.until(lambda: newest().get("mcs: hangs") and newest()["mcs: hangs"].level == DiagnosticStatus.ERROR)
    assert "BudgetError: a call took" in newest()["mcs: hangs"].message
    # the timing is told once a second, and not while simulated time stands still: a fast computer is soon at a place
    places = itertools.cycle([HOME, target])
    client.until(lambda: client.move(next(places)).success and values(newest()["mcs: count"])["calls"] > 100)
    latest = newest()
    assert list(latest) == ["mcs: control", "mcs: report", "mcs: count", "mcs: hangs"]
    assert values(latest["mcs: hangs"])["calls"] == 21
    assert latest["mcs: count"].level == DiagnosticStatus.OK
    calls = {name: values(status)["calls"] for name, status in latest.items()}
    assert abs(calls["mcs: control"] - 2 * calls["mcs: count"]) <= 2


def values(status):
    return {each.key: int(each.value) for each in status.values if each.value.isdigit()}
