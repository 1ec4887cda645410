"""The last two seconds of every joint, kept and written on an abort."""

import csv
import json

import numpy as np
import pytest

from im_core.errors import ImError, LimitError
from im_mcs.client.evidence import AT_ONCE, EACH_S, EvidenceLimit, write_evidence
from im_mcs.protocol.evidence import KEPT, PER_JOINT, Recorder, Records, record_type


@pytest.fixture
def memory():
    return np.zeros(KEPT, record_type(rows=10, n_joints=3, n_wrenches=2))


def fill(recorder, ticks):
    for tick in ticks:
        q = np.array([tick, 10.0 * tick, 0.0])
        setpoint = np.array([q + 0.5, q + 1.0, q + 2.0])
        recorder.put_row(tick, 4500 * tick, (q, -q, 2.0 * q), setpoint, np.full((2, 6), float(tick)))


def test_a_record_holds_the_newest_ticks_in_order(memory):
    recorder, records = Recorder(memory), Records(memory)
    fill(recorder, range(24))
    number = recorder.freeze()
    assert recorder.freeze() == number  # one a tick
    assert records.read(number) is None  # this tick's row is still to come
    fill(recorder, [24])
    record = records.read(number)
    np.testing.assert_array_equal(record["tick"], range(15, 25))
    np.testing.assert_array_equal(record["stamp_ns"], 4500 * record["tick"])
    np.testing.assert_array_equal(record["q"][:, 1], 10.0 * record["tick"])
    np.testing.assert_array_equal(record["v"], -record["q"])
    np.testing.assert_array_equal(record["tau"], 2.0 * record["q"])
    np.testing.assert_array_equal(record["setpoint_a"], record["q"] + 2.0)
    np.testing.assert_allclose(record["following_error"], 0.5)
    assert record["wrench"].shape == (10, 2, 6)
    fill(recorder, range(25, 60))
    np.testing.assert_array_equal(records.read(number)["tick"], range(15, 25))  # it stays


def test_a_short_run_gives_a_short_record_and_old_records_make_room(memory):
    recorder, records = Recorder(memory), Records(memory)
    assert records.read(1) is None
    assert records.read(0) is None
    fill(recorder, range(3))
    numbers = []
    for tick in range(3, 9):
        numbers.append(recorder.freeze())
        fill(recorder, [tick])
    assert numbers == [1, 2, 3, 4, 5, 6]
    for number in numbers[:-KEPT]:
        assert records.read(number) is None
    for number in numbers[-KEPT:]:
        assert records.read(number)["tick"][-1] == number + 2


def test_evidence_is_written_whole_as_arrays_and_as_a_table(memory, tmp_path):
    recorder = Recorder(memory)
    number = recorder.freeze()
    fill(recorder, [7])
    record = Records(memory).read(number)
    fault = LimitError(joint="b", value=2.0, limit=1.0, unit="rad")
    path = write_evidence(tmp_path / "new", record, fault, ("a", "b", "c"))
    with np.load(path) as kept:
        for name, array in record.items():
            np.testing.assert_array_equal(kept[name], array)
        assert json.loads(str(kept["fault"]))["facts"]["joint"] == "b"
    lines = path.with_suffix(".csv").read_text().splitlines()
    assert lines[0] == f"# {fault.message}"
    rows = list(csv.DictReader(lines[1:]))
    assert float(rows[0]["b.q"]) == 70.0
    assert len(rows[0]) == 2 + len(PER_JOINT) * 3 + 12
    assert sorted(file.suffix for file in path.parent.iterdir()) == [".csv", ".npz"]


def test_evidence_of_a_servo_that_was_started_again_takes_the_place_of_none(memory, tmp_path, monkeypatch):
    for began in ("20260101-000000", "20260101-000007"):
        monkeypatch.setattr("im_mcs.client.evidence.clock.stamp_name", lambda began=began: began)
        recorder = Recorder(memory)
        number = recorder.freeze()
        fill(recorder, [7])
        write_evidence(tmp_path, Records(memory).read(number), ImError("x", code="joint"))
    stems = sorted(path.stem for path in tmp_path.glob("*.npz"))
    assert stems == ["20260101-000000_000000007_joint", "20260101-000007_000000007_joint"]


def test_a_folder_that_cannot_be_is_a_sentence(memory, tmp_path):
    (tmp_path / "file").write_text("")
    recorder = Recorder(memory)
    number = recorder.freeze()
    fill(recorder, [1])
    with pytest.raises(ImError, match="evidence cannot be written to"):
        write_evidence(tmp_path / "file" / "sub", Records(memory).read(number), ImError("x"))


def test_an_abort_names_its_record_and_the_record_shows_the_fault(bench, cell):
    bench.to_motion("left")
    points = [(cell.home[:9] + 0.3).tolist()]
    goal = bench.send("move", group="left", path={"kind": "joint", "points": points})
    for _ in range(100):
        bench.mcs.tick([])
    jammed = bench.driver.q[5]
    for _ in range(1500):
        bench.driver.q[5], bench.driver.v[5] = jammed, 0.0
        bench.mcs.tick([])
        if bench.reply(goal) is not None:
            break
    reply = bench.reply(goal)
    record = bench.records.read(reply["results"]["evidence"])
    facts = reply["error"]["facts"]
    assert record["tick"][-1] == facts["tick"]
    assert np.abs(record["following_error"][-2]).argmax() == 5  # in the tick of the e-stop there is no setpoint
    assert record["following_error"][-2, 5] == pytest.approx(facts["value"], abs=0.005)
    assert len(record["tick"]) <= round(bench.mcs.config.safety.record_s / 0.0045)


def test_a_flood_of_one_fault_writes_few_files_and_leaves_room_for_another():
    limit, begin = EvidenceLimit(), 1000.0
    flood = [begin + k / 30.0 for k in range(30 * 60)]
    written = [now for now in flood if limit.allows("tolerance", now)]
    assert written[:AT_ONCE] == flood[:AT_ONCE]
    assert len(written) == pytest.approx(AT_ONCE + 60.0 / EACH_S, abs=2)
    assert limit.allows("state", flood[-1])
    later = flood[-1] + AT_ONCE * EACH_S
    assert [limit.allows("tolerance", later) for _ in range(AT_ONCE + 1)] == [True] * AT_ONCE + [False]
