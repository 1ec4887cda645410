"""The marking of every net at any moment of a recording: what was published, and what firings have made of it since."""

from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from im_core.errors import DataError
from im_pnt.execution.notification import Firing, Phase
from im_pnt.netfile import parse_net
from im_pnt_analysis.recorded.firings import Mission, MissionTime
from im_pnt_analysis.recorded.timeline import Described, Description, Moment, NetRecording, RecordedMarking

JOB = """
net: job_net
places: {idle: 1, begin: , end: , bad: , lent: {remote: true}, unknown: }
transitions:
  read: {symbol: job, in: idle, out: begin}
  work: {in: [begin, lent], out: end, action: work, on_failure: [bad], on_doubt: [unknown]}
  tell: {in: end, out: idle, emit: job_done}
  regret: {in: bad, out: idle, emit: job_failed}
  forget: {in: unknown, out: idle}
"""


def fired(transition, sequence, phase=Phase.END):
    return Firing("job_net", transition, sequence, phase, "", 1, "", 0.0, -1.0)


def marked(sequence, **tokens):
    return RecordedMarking("job_net", sequence, tokens, "automatic", False, ())


def recording(*events, texts=(JOB,)):
    descriptions = [Description(parse_net(text, "net"), "/node") for text in texts]
    told = [Described("job_net", 0), *events]
    moments = [Moment(float(rank), event) for rank, event in enumerate(told)]
    return NetRecording(descriptions, moments, Mission([], [], {}))


def tokens(shown, firing):
    return dict(shown.states(shown.position_of(firing))["job_net"].marking.tokens)


def test_between_markings_firings_move_the_tokens_of_the_expanded_net():
    shown = recording(marked(0, idle=1, lent=1), fired("read", 1), fired("work", 2, Phase.START), fired("work", 3))
    assert tokens(shown, 0) == {"idle": 1, "lent": 1}
    assert tokens(shown, 1) == {"begin": 1, "lent": 1}
    assert tokens(shown, 2) == {"work.active": 1}
    assert tokens(shown, 3) == {"end": 1}


def test_a_net_that_was_unloaded_is_there_until_then():
    shown = recording(marked(0, idle=1), fired("read", 1), Described("job_net", None), Described("job_net", 0))
    described = [shown.states(position)["job_net"].description for position in range(len(shown.moments) + 1)]
    assert described == [0, 0, None, 0]


@pytest.mark.parametrize(
    ("phases", "left"),
    [
        ((Phase.FAILED,), {"bad": 1}),
        ((Phase.CANCEL,), {"work.cancelling": 1}),
        ((Phase.CANCEL, Phase.END), {"end": 1}),
        ((Phase.CANCEL, Phase.DOUBT), {"work.in_doubt": 1}),
        ((Phase.DOUBT, Phase.FAILED), {"bad": 1}),
    ],
)
def test_an_action_ends_from_whatever_phase_it_has_come_to(phases, left):
    later = [fired("work", number, phase) for number, phase in enumerate(phases, 3)]
    shown = recording(marked(0, idle=1, lent=1), fired("read", 1), fired("work", 2, Phase.START), *later)
    assert tokens(shown, 2 + len(phases)) == left


def test_a_token_that_nobody_told_of_came_from_another_net():
    shown = recording(fired("read", 1), fired("work", 2, Phase.START))
    assert tokens(shown, 2) == {"work.active": 1}


def test_a_recorded_marking_is_taken_as_it_is():
    """For instance where an action in doubt was given up: the firing says that it failed, and not where tokens go."""
    shown = recording(fired("read", 1), fired("work", 2, Phase.START), marked(4, unknown=1), fired("forget", 5))
    assert shown.states(3)["job_net"].marking.tokens == {"unknown": 1}
    assert tokens(shown, 3) == {"idle": 1}


def test_what_comes_late_changes_nothing():
    """Two topics of one turn may come in either order: a marking before its firing, or after the next one."""
    early = recording(marked(0, idle=1), fired("read", 1), marked(2, end=1), fired("work", 2))
    assert tokens(early, 2) == {"end": 1}
    late = recording(marked(0, idle=1), fired("read", 1), fired("tell", 2), marked(1, begin=1))
    assert late.states(3) == late.states(2)


@pytest.mark.parametrize("again", [(marked(0, idle=1), fired("read", 1)), (fired("read", 1), marked(1, begin=1))])
def test_a_net_that_begins_anew_is_marked_as_at_its_beginning(again):
    shown = recording(fired("read", 1), fired("work", 2, Phase.START), fired("work", 3, Phase.FAILED), *again)
    assert tokens(shown, 4) == {"begin": 1}


def test_a_net_of_another_text_is_that_one_from_then_on():
    other = "net: job_net\nplaces: {idle: 1, gone: }\ntransitions: {read: {in: idle, out: gone}}\n"
    shown = recording(
        fired("read", 1), Described("job_net", 1), marked(0, idle=1), fired("read", 1), texts=(JOB, other)
    )
    assert tokens(shown, 1) == {"begin": 1}
    assert tokens(shown, 2) == {"gone": 1}
    assert [shown.states(position)["job_net"].description for position in (1, 2)] == [0, 1]


@given(st.lists(st.sampled_from(["read", "tell", "regret", "work"]), min_size=1, max_size=900), st.data())
def test_any_moment_is_as_if_all_before_it_were_played(transitions, chosen):
    shown = recording(*(fired(name, number) for number, name in enumerate(transitions, 1)))
    position = chosen.draw(st.integers(0, len(shown.moments)))
    states = shown.states(0)
    for moment in shown.moments[:position]:
        shown.advance(states, moment)
    assert shown.states(position) == states


def test_moments_are_found_by_time_and_by_firing():
    shown = recording(marked(0, idle=1), fired("read", 1), marked(1, begin=1), fired("work", 2, Phase.START))
    assert [shown.position_at(at_s) for at_s in (-1.0, 1.9, 2.0, 3.5, 99.0)] == [0, 0, 1, 2, 3]
    assert [shown.position_of(firing) for firing in (0, 1, 2)] == [0, 1, 3]
    assert [shown.firings_until(position) for position in range(4)] == [0, 1, 1, 2]
    assert [firing.transition for _, firing in shown.firings_before(3, 1)] == ["work"]
    with pytest.raises(DataError, match="there is no firing 3: the recording has 2"):
        shown.position_of(3)


def test_time_goes_on_where_a_testbed_begins_anew():
    def told(net, stamp_s):
        whole = int(stamp_s)
        return SimpleNamespace(net=net, stamp=SimpleNamespace(sec=whole, nanosec=round((stamp_s - whole) * 1e9)))

    firings = [("a", 5.0), ("b", 25.0), ("a", 8.0), ("c", 0.0), ("b", 2.0), ("a", 3.0), ("b", 4.0)]
    time = MissionTime(told(*firings[0]))
    assert [time.of(told(*each)) for each in firings] == [0.0, 20.0, 3.0, 20.0, 20.0, 21.0, 22.0]
