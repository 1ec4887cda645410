from hypothesis import given
from hypothesis import strategies as st

from im_bringup.machine import bootstrap as phases
from im_bringup.machine import machine_state as machine
from im_bringup.machine.nets import MachineNets
from im_bringup.machine.start import print_parts
from im_bringup.tasks.registry import Progress, Registry
from im_core.processes.startup import StartupPhase
from support.tasks import NAMES, bootstrap, placed

ORDER = [Progress.LOADED, Progress.CONFIGURED, Progress.READY]


@given(st.lists(st.tuples(st.sampled_from(NAMES), st.sampled_from(ORDER)), max_size=40))
def test_no_task_is_told_to_go_on_before_all_have_arrived(tmp_path_factory, reports):
    value = bootstrap(tmp_path_factory.getbasetemp())
    reached = dict.fromkeys(NAMES, Progress.STARTING)
    for name, progress in reports:
        value.heard(name, 7, 1, progress, "", now=0.0)
        reached[name] = progress
        before = value.phase
        value.poll(0.0)
        if value.phase is not before:
            assert value.phase == before + 1
            assert all(progress >= ORDER[before] for progress in reached.values())
        if value.state == machine.READY:
            assert value.phase is StartupPhase.START


def test_all_ready_is_ready(tmp_path):
    value = bootstrap(tmp_path)
    for progress in ORDER:
        assert value.state == machine.STARTING
        for name in NAMES:
            value.heard(name, 7, 1, progress, "", now=0.0)
        value.poll(0.0)
        value.poll(0.0)
    assert value.state == machine.READY
    assert value.missing() == []


def test_the_parts_of_a_start_share_all_of_its_time(tmp_path):
    class Nets(MachineNets):
        proof = False

        def settled(self, _):
            return self.proof

    nets = Nets(tmp_path, unproved=False)
    value = bootstrap(tmp_path, nets=nets)
    for progress, now in ((Progress.LOADED, 2.0), (Progress.CONFIGURED, 2.5)):
        for name in NAMES:
            value.heard(name, 7, 1, progress, "", now)
        value.changed()
        value.poll(now)
        assert value.changed()  # so that the part is told while the next one lasts
    value.poll(2.75)
    nets.proof = True
    value.poll(3.5)
    for name in NAMES:
        value.heard(name, 7, 1, Progress.READY, "", 3.75)
    value.poll(3.75)
    value.poll(90.0)
    assert value.state == machine.READY
    assert value.took == {"load": 2.0, "configure": 0.5, "nets": 1.0, "start": 0.25}


def test_who_is_missing_is_named_with_the_reason(tmp_path):
    value = bootstrap(tmp_path)
    value.heard("one", 7, 1, Progress.LOADED, "", now=0.0)
    assert value.missing() == [
        "one is loaded, not ready",
        "two is starting, not ready",
        "three is starting, not ready",
    ]
    value.heard("two", 7, 1, Progress.FAILED, "mcs.yaml:3: slots: missing", now=0.0)
    value.poll(0.0)
    assert value.state == machine.FAILED
    assert value.missing() == ["two failed: mcs.yaml:3: slots: missing"]


def test_a_task_that_dies_before_the_machine_was_ready_makes_the_start_fail(tmp_path):
    children = {}
    value = bootstrap(tmp_path, children)
    (tmp_path / "two").write_text("line\nno such module\n\n")
    children["two"].code = 1
    value.poll(0.0)
    assert value.state == machine.FAILED
    (sentence,) = value.missing()
    assert sentence.startswith("two died: it ended with exit code 1: no such module (log: ")


def test_a_task_that_dies_later_is_started_again_and_catches_up(tmp_path):
    children = {}
    value = bootstrap(tmp_path, children)
    for progress in ORDER:
        for name in NAMES:
            value.heard(name, 7, 1, progress, "", now=0.0)
        value.poll(0.0)
    value.poll(0.0)
    children["two"].code = -9
    value.poll(10.0)
    assert value.registry.find("two").progress is Progress.DEAD
    assert "was killed by SIGKILL" in value.registry.find("two").detail
    value.heard("two", 7, 1, Progress.READY, "", now=10.1)  # a late heartbeat of the dead process
    assert value.registry.find("two").progress is Progress.DEAD
    value.poll(10.5)
    assert value.registry.find("two").restarts == 0
    value.poll(11.1)
    record = value.registry.find("two")
    assert (record.progress, record.restarts) == (Progress.STARTING, 1)
    value.heard("two", 7, 2, Progress.READY, "", now=11.5)
    assert value.registry.find("two").progress is Progress.READY
    assert (value.phase, value.state) == (StartupPhase.START, machine.READY)


def test_tasks_of_other_hosts_are_as_their_agent_tells():
    registry = Registry(placed(host="far"), local_host="localhost")
    registry.agent_heard("far", now=0.0)
    assert registry.heard("one", 4, 1, Progress.READY, "")
    assert not registry.heard("one", 4, 1, Progress.READY, "")
    registry.agent_heard("far", now=5.0)
    assert registry.silence(10.0) == []  # a task may say nothing for long while its agent lives
    silent = registry.silence(12.0)
    assert [record.name for record in silent] == list(NAMES)
    assert {record.detail for record in silent} == {
        "nothing was heard of host far for 7.0 s; its agent has ended, or the network between the hosts is cut"
    }
    assert registry.silence(13.0) == []
    assert registry.heard("one", 5, 2, Progress.READY, "")
    assert registry.find("one").restarts == 1
    assert not registry.heard("stranger", 5, 2, Progress.READY, "")


def test_the_death_of_a_task_of_another_host_is_told_by_its_agent():
    registry = Registry(placed(host="far"), local_host="localhost")
    registry.heard("one", 4, 1, Progress.READY, "")
    assert registry.heard("one", 0, 1, Progress.DEAD, "it was killed by SIGKILL")
    assert (registry.find("one").progress, registry.find("one").detail) == (Progress.DEAD, "it was killed by SIGKILL")
    assert registry.heard("one", 9, 2, Progress.READY, "")
    assert registry.find("one").restarts == 1


def test_phases_pass_one_by_one():
    registry = Registry(placed(), local_host="localhost")
    for name in NAMES:
        registry.started(name, 7, 0)
        registry.heard(name, 7, 1, Progress.READY, "")
    phase = StartupPhase.LOAD
    for expected in (StartupPhase.CONFIGURE, StartupPhase.START, StartupPhase.START):
        phase = phases.next_phase(phase, registry.records())
        assert phase is expected


def test_start_says_what_its_time_went_into(capsys):
    print_parts({"preflight": 0.1, "bootstrap": 0.72, "load": 2.0, "configure": 0.5, "nets": 1.04, "start": 0.25})
    assert capsys.readouterr().out == (
        "start: preflight 0.1 s, bootstrap 0.7 s, processes and discovery 2.0 s, configuration 0.5 s, "
        "verification of nets 1.0 s, first service 0.2 s\n"
    )
