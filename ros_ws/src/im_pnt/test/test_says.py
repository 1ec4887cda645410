"""What transitions say: progress and failures in the user's words."""

import pytest

from im_core.errors import DataError, ImError
from im_pnt.errors import NetFileError
from im_pnt.execution.events import Answer, CommandCancelled, Outcome
from im_pnt.execution.values import run_at_once
from im_pnt.expression.scope import check_net
from im_pnt.netfile import parse_net
from im_pnt.netfile.writer import yaml_text
from support.process import Clock, Process, hold

NET = """
net: n
commands:
  go:
    arguments: {{points: {{type: integers, length: [1, 3]}}, speed: {{type: number, default: 0.5}}}}
places: {{idle: 1, wanted: , there: , bad: }}
transitions:
  begin: {{symbol: go, in: idle, out: wanted}}
  reach: {{in: wanted, out: there, action: reach, on_failure: bad, says: "{}", timeout: 5}}
  end: {{in: there, out: idle, emit: go_done}}
  fail: {{in: bad, out: idle, emit: go_failed}}
"""
SAYS = "reach point ${arguments.points[0]} at ${arguments.speed} m/s"
REASON = DataError("no way", joint="j1")


def started(says: str = SAYS) -> tuple[Process, int]:
    process = Process([parse_net(NET.format(says))], {"reach": hold}, clock=Clock())
    return process, process.command("n", "go", points=[2])


def test_progress_and_failure_say_it_with_the_arguments_and_the_failure_keeps_its_facts():
    process, _ = started()
    assert process.recorder.progress == [("reach point 2 at 0.5 m/s", -1.0)]
    process.end("reach", REASON)
    error = process.results[0].error
    assert error.message == "could not reach point 2 at 0.5 m/s: no way"
    assert (error.code, error.facts) == (REASON.code, {"joint": "j1"})


def test_a_cancelled_action_and_one_in_doubt_keep_their_sentences():
    process, number = started()
    process.exchange.nets["n"].post(CommandCancelled(number, ImError("enough", code="cancelled")))
    process.pump()
    process.end("reach", ImError("enough", code="cancelled"))
    process.answers["reach"] = Answer(Outcome.UNKNOWN, asked="nobody")
    process.command("n", "go", points=[3])
    process.wait(10.0)
    first, second = (each.error.message for each in process.results)
    assert first == "enough"
    assert second.startswith("the outcome of function reach")


def test_a_value_that_is_not_there_keeps_no_action_from_its_work():
    process, _ = started("reach point ${arguments.points[2]}")
    process.end("reach")
    assert process.recorder.progress == [("reach point ${arguments.points[2]}", -1.0)]
    assert process.results[0].success


@pytest.mark.parametrize(
    ("says", "sentence"),
    [
        ("reach ${arguments.point}", "go, served here, has no such argument (did you mean 'points'?)"),
        ("reach ${answers.reach.x}", "answers.reach is not known as the action begins"),
        ("reach ${answers.look.x}", "answers.look: there is no transition 'look'"),
        ("reach ${data.at.data}", "no place says of what type data object 'at' is"),
    ],
)
def test_what_it_cannot_say_is_refused_where_it_stands(says, sentence):
    with pytest.raises(NetFileError, match=r"net:9:\d+: transitions.reach.says: ") as refused:
        check_net(parse_net(NET.format(says)), None)
    assert sentence in str(refused.value)


def test_it_needs_an_action_and_is_written_as_it_was_read():
    with pytest.raises(NetFileError, match="needs an action that can fail"):
        parse_net(NET.format(SAYS).replace("out: wanted}", "out: wanted, says: begin}"))
    net = parse_net(NET.format(SAYS))
    assert parse_net(yaml_text(net)).transitions["reach"].says == SAYS


class LateObjects:
    """Data objects whose reads are answered when the test says so."""

    def __init__(self, **objects):
        self.objects, self.reads = objects, []

    async def read(self, name, kind, ways):
        if name not in self.objects:
            raise DataError(f"there is no data object {name}")
        return self.objects[name]

    def run(self, work, done):
        self.reads.append((work, done))

    def answer(self, process):
        reads, self.reads = self.reads, []
        for work, done in reads:
            run_at_once(work, done)
        process.pump()


ELEMENT = NET.replace("wanted: ,", "wanted: {{data_object: {{name: at, type: p_msgs/msg/At, scope: global}}}},").format(
    "reach point ${data.at.index + 1}, at ${arguments.points[data.at.index]}"
)


def late(**objects: object) -> tuple[Process, LateObjects]:
    known = LateObjects(**objects)
    process = Process([parse_net(ELEMENT)], {"reach": hold}, clock=Clock(), objects=known)
    process.command("n", "go", points=[4, 7])
    return process, known


def test_a_data_object_tells_which_element_it_is():
    process, objects = late(at={"index": 1})
    assert not process.recorder.progress, "the action does not wait for its text"
    objects.answer(process)
    assert process.recorder.progress == [("reach point 2, at 7", -1.0)]
    objects.objects["at"] = {"index": 0}
    process.end("reach", REASON)
    assert [result.error.message for result in process.results] == ["could not reach point 2, at 7: no way"]


def test_a_failure_waits_for_its_text_and_success_does_not():
    process, objects = late(at={"index": 0})
    process.end("reach", REASON)
    assert not process.results
    objects.answer(process)
    assert [result.error.message for result in process.results] == ["could not reach point 1, at 4: no way"]
    process, objects = late(at={"index": 0})
    process.end("reach")
    assert process.results[0].success
    objects.answer(process)
    assert not process.recorder.progress
    assert not process.recorder.troubles


def test_without_its_data_object_the_text_is_shown_as_written():
    process, objects = late()
    process.end("reach", REASON)
    objects.answer(process)
    said = "reach point ${data.at.index + 1}, at ${arguments.points[data.at.index]}"
    assert [result.error.message for result in process.results] == [f"could not {said}: no way"]
