"""``pnt time`` and ``pnt simulate`` as people call them, good input and bad."""

import json
from xml.etree import ElementTree

import pytest

from im_core.errors import ImError
from im_pnt.execution.notification import Firing, Phase
from im_pnt.netfile import parse_net
from im_pnt_analysis.cli import main
from im_pnt_analysis.cli.terminal import BAD_INPUT, OK
from im_pnt_analysis.timed.measurement import MeasuredFiring, measured_firings, read_measurement

QUEUE = """
net: mm15
places: {free: 5, queue: }
transitions:
  arrive: {in: free, out: queue, delay: {exponential: {rate: 2}}}
  serve: {in: queue, out: free, delay: {exponential: {rate: 3}}}
"""

JOB = """
net: job_net
places: {idle: 1, begin: , end: , bad: }
transitions:
  read: {symbol: job, in: idle, out: begin}
  work: {in: begin, out: end, action: work, delay: 2.5, on_failure: [bad]}
  tell: {in: end, out: idle, emit: job_done}
  regret: {in: bad, out: idle, emit: job_failed}
"""


@pytest.fixture
def queue(tmp_path):
    file = tmp_path / "queue.yaml"
    file.write_text(QUEUE)
    return str(file)


@pytest.fixture
def job(tmp_path):
    file = tmp_path / "job.yaml"
    file.write_text(JOB)
    return str(file)


def records(*rows):
    keys = ("net", "transition", "phase", "symbol", "stamp", "duration")
    return [dict(zip(keys, ("job_net", *row), strict=True)) for row in rows]


RUN = records(
    ("read", 1, "job", {"sec": 10, "nanosec": 0}, 0.0),
    ("work", 0, "", {"sec": 10, "nanosec": 0}, 0.0),
    ("work", 1, "", {"sec": 13, "nanosec": 500_000_000}, 0.02),
    ("tell", 1, "job_done", {"sec": 13, "nanosec": 500_000_000}, 0.0),
)


def test_time_prints_the_steady_state(queue, capsys):
    assert main(["time", queue, "--json"]) == OK
    answer = json.loads(capsys.readouterr().out)
    assert answer["fractions"]["throughput"]["serve"] == "1266/665"
    assert answer["throughput"]["serve"] == pytest.approx(1266 / 665)
    assert sum(row["share"] for row in answer["probability"]) == pytest.approx(1.0)
    assert main(["time", queue]) == OK
    assert "1266/665 = 1.90376" in capsys.readouterr().out


def test_time_of_a_command_beside_a_measured_run(job, tmp_path, capsys):
    file = tmp_path / "firings.json"
    file.write_text("\n".join(json.dumps(record) for record in RUN))
    assert main(["time", job, "--command", "job", "--measured", str(file), "--json"]) == OK
    answer = json.loads(capsys.readouterr().out)
    assert (answer["mean"], answer["bottleneck"], answer["done"]) == (2.5, "work", 1.0)
    assert answer["comparison"]["measured"] == 3.5
    assert answer["comparison"]["plausible"] is False
    assert main(["time", job, "--command", "job", "--measured", str(file), "--fit"]) == OK
    out = capsys.readouterr().out
    assert "job: 3.5 s expected, exact" in out
    assert "measured     3.5 s, between" in out


@pytest.mark.parametrize("suffix", ["svg", "png"])
def test_drawings(job, queue, tmp_path, suffix):
    for arguments in ([job, "--command", "job"], [queue]):
        output = tmp_path / f"out.{suffix}"
        assert main(["time", *arguments, "-o", str(output)]) == OK
        if suffix == "svg":
            assert ElementTree.parse(output).getroot().tag.endswith("svg")
        else:
            assert output.read_bytes().startswith(b"\x89PNG")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["job.yaml", f"out.{suffix}", "queue.yaml"]


def test_simulate_prints_lines_or_objects(queue, capsys):
    assert main(["simulate", queue, "--until", "5", "--json"]) == OK
    *steps, end = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert all(step["time"] <= 5.0 for step in steps)
    assert [step["step"] for step in steps] == list(range(1, len(steps) + 1))
    assert "end" in end
    assert main(["simulate", queue, "--summary", "--steps", "2000"]) == OK
    out = capsys.readouterr().out
    assert out.startswith("2000 firings in ")
    assert "+-" in out


def test_simulate_replays(queue, tmp_path, capsys):
    assert main(["simulate", queue, "--replay", "arrive -> arrive -> serve"]) == OK
    out = capsys.readouterr().out
    assert "free=4, queue=1" in out
    assert out.endswith("enabled: arrive, serve\n")
    file = tmp_path / "counterexample.json"
    file.write_text(
        json.dumps({"nets": ["mm15"], "reason": "it shows", "sequence": ["serve"], "repeat": [], "marking": {}})
    )
    assert main(["simulate", queue, "--replay", str(file)]) == BAD_INPUT
    assert "step 1: transition serve is not enabled: place queue holds 0 of the 1 tokens" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["time", "{queue}", "--command", "job"], "no transition of mm15 reads the symbol 'job'"),
        (["time", "{queue}", "-o", "x.pdf"], "must end in .svg or .png"),
        (["time", "{queue}", "-o", "/nowhere/x.svg"], "cannot write '/nowhere/x.svg'"),
        (["time", "{queue}", "--timeout", "nan"], "nan is not a time for the search"),
        (["time", "{queue}", "--measured", "/nowhere"], "cannot read measured times from '/nowhere'"),
        (["time", "{queue}", "--fit"], "--fit needs measured times: give --measured FILE"),
        (["time", "{job}", "--command", "job", "--approximate"], "--approximate has no effect with --command"),
        (["time", "{job}", "--command", "job", "--timeout", "0"], "--timeout has no effect with --command"),
        (["time", "{queue}", "--runs", "10"], "--runs has no effect without --command"),
        (["time", "{queue}", "--seed", "0"], "--seed has no effect without --command"),
        (["simulate", "{queue}", "--replay", "serve", "--steps", "3"], "--steps has no effect with --replay"),
        (["simulate", "{queue}", "--replay", "serve", "--failures", "0"], "--failures has no effect with --replay"),
        (["time", "{job}", "--command", "job", "--runs", "1"], "1 runs are too few"),
        (["simulate", "{queue}", "--until", "nan"], "cannot end at time nan"),
        (["simulate", "{queue}", "--failures", "1.5"], "1.5 is not a probability"),
        (["simulate", "{queue}", "--steps", "-1"], "-1 firings cannot be played"),
        (["simulate", "{queue}", "--replay", "/nowhere"], "cannot read the firing sequence '/nowhere'"),
    ],
)
def test_bad_input_is_one_sentence(queue, job, arguments, message, capsys):
    assert main([text.format(queue=queue, job=job) for text in arguments]) == BAD_INPUT
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_times_of_other_nets_are_not_taken(queue, job, tmp_path, capsys):
    file = tmp_path / "run.json"
    for measured, message in (
        (json.dumps(RUN), f"'{file}' has no firing of a transition of mm15; it has job_net.read, job_net.tell, job_ne"),
        ('{"mm15.arrive": [1, 2], "mm15.depart": [1]}', "is of another version of net mm15: it has no depart"),
    ):
        file.write_text(measured)
        assert main(["time", queue, "--measured", str(file), "--fit"]) == BAD_INPUT
        assert message in capsys.readouterr().err
    file.write_text('{"mm15.arrive": [1, 2], "mm15.accept.other": [1], "elsewhere.x": [1]}')
    assert main(["time", queue, "--measured", str(file), "--fit"]) == OK


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "the file has no firings"),
        ("3", "a JSON list or object is needed"),
        ('{"a.b": [1, -2]}', "'a.b' must be a list of times"),
        ('{"a.b": 3}', "'a.b' must be a list of times"),
        ("[3]", "entry 1 is not an object"),
        ('[{"net": "a", "transition": "b"}]', "entry 1 needs net, transition"),
        ('[{"net": "a", "transition": "b", "phase": 1, "duration": "x"}]', "entry 1 has the time 'x'"),
        ('{"net": "a"}\n{', "line 2: not JSON"),
        ("[" * 100_000, "line 1: values nest deeper than 40"),
    ],
)
def test_measurements_that_cannot_be_read(tmp_path, content, message):
    file = tmp_path / "firings"
    file.write_text(content)
    with pytest.raises(ImError, match=message):
        read_measurement(str(file))


def test_measurements_in_their_forms(tmp_path):
    file = tmp_path / "firings"
    file.write_text('{"a.b": [1.0, 2.0]}')
    assert read_measurement(str(file)).by_transition() == {"a.b": [1.0, 2.0]}
    file.write_text(json.dumps(RUN))
    measured = read_measurement(str(file))
    assert measured.commands == {"job": (3.5,)}
    assert measured.by_transition()["job_net.work"] == [3.5]
    for record in RUN:
        assert "stamp" in record
    file.write_text(json.dumps([{k: v for k, v in record.items() if k != "stamp"} for record in RUN]))
    assert read_measurement(str(file)).by_transition()["job_net.work"] == [0.02]


def test_a_command_ends_with_the_symbol_that_answers_it_wherever_its_net_names_that(tmp_path):
    file = tmp_path / "firings"
    net = parse_net(
        "net: n\nplaces: {a: 1, b: }\ntransitions:\n"
        "  go: {symbol: pick, in: a, out: b, action: f, on_failure: b}\n"
        "  end: {in: b, out: a, emit: [lamp_off, pick_done]}\n"
        "  at_once: {symbol: put, in: a, out: a, emit: put_done}\n"
    )
    told = [("go", 0, "pick", 0.0), ("go", 1, "", 1.0), ("end", 1, "lamp_off", 2.0), ("at_once", 1, "put", 3.0)]
    file.write_text(
        json.dumps([{"net": "n", "transition": t, "phase": p, "symbol": s, "stamp": at} for t, p, s, at in told])
    )
    assert read_measurement(str(file), [net]).commands == {"pick": (2.0,), "put": (0.0,)}
    assert read_measurement(str(file)).commands == {}


def test_observations_are_the_ends_of_firings():
    def firing(phase, duration):
        return Firing("n", "t", 1, phase, "", 0, "", duration, 0.0)

    seen = measured_firings([firing(Phase.START, 0.0), firing(Phase.END, 1.5), firing(Phase.FAILED, 2.0)])
    assert seen == [MeasuredFiring("n.t", 1.5), MeasuredFiring("n.t", 2.0, failed=True)]
