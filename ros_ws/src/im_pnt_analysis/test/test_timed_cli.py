"""``pnt time`` and ``pnt simulate`` as people call them, good input and bad."""

import json

import pytest

from im_pnt_analysis.cli import main
from im_pnt_analysis.cli.terminal import BAD_INPUT, OK

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


def test_time_prints_the_steady_state(queue, capsys):
    assert main(["time", queue, "--json"]) == OK
    answer = json.loads(capsys.readouterr().out)
    assert answer["throughput"]["serve"] == pytest.approx(1266 / 665)
    assert sum(row["share"] for row in answer["probability"]) == pytest.approx(1.0)
    assert main(["time", queue]) == OK
    assert "1.90376" in capsys.readouterr().out


def test_time_of_a_command(job, capsys):
    assert main(["time", job, "--command", "job", "--json"]) == OK
    answer = json.loads(capsys.readouterr().out)
    assert (answer["mean"], answer["bottleneck"], answer["done"]) == (2.5, "work", 1.0)
    assert main(["time", job, "--command", "job"]) == OK
    assert "job: 2.5 s expected, exact" in capsys.readouterr().out


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
        (["time", "{queue}", "--timeout", "nan"], "nan is not a time for the search"),
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
