"""START is given when the nets of all tasks may run together, and to no machine whose nets may not."""

import json
import sys

import pytest

from im_bringup.machine import machine_state as machine
from im_bringup.machine.nets import MachineNets
from im_bringup.tasks.registry import Progress
from im_core import clock
from im_core.errors import DataError
from im_core.processes.agent_socket import TaskReport
from im_core.processes.process import ChildProcess
from im_core.processes.startup import StartupPhase, net_digest, nets_sentence, nets_told
from support.tasks import NAMES, bootstrap


class Prover:
    """Stands for ``pnt verify``: a process that says what it is told to, and ends with a code."""

    def __init__(self, code, says):
        self.argv = [sys.executable, "-S", "-c", f"print({says!r}); raise SystemExit({code})"]
        self.files = []

    def __call__(self, files, log):
        self.files.append(sorted(file.name for file in files))
        return ChildProcess(self.argv, log=log)


def machine_of(tmp_path, prover, *, unproved=False):
    nets = MachineNets(tmp_path, unproved=unproved, prove=prover)
    value = bootstrap(tmp_path, nets=nets)
    for progress in (Progress.LOADED, Progress.CONFIGURED):
        for name in NAMES:
            detail = nets_sentence({"one": ["a", "b"], "two": ["c"]}.get(name, []))
            configured = progress is Progress.CONFIGURED
            digests = {net: net_digest(f"net: {net}") for net in nets_told(detail)} if configured else {}
            value.reported(TaskReport(name, 1, progress, detail if configured else "", digests), 7, "localhost", 0.0)
        value.poll(0.0)
    return value, nets


def describe(nets, told=(("/one", "a"), ("/one", "b"), ("/two", "c"))):
    for node, net in told:
        nets.described(node, net, json.dumps({"net": net, "yaml": f"net: {net}", "journal": True}))


def poll_until(value, condition):
    deadline = clock.monotonic() + 60.0
    while not condition() and clock.monotonic() < deadline:
        value.poll(0.0)
        clock.sleep(0.01)
    assert condition()


def test_start_waits_for_all_descriptions_and_for_the_proof(tmp_path):
    prover = Prover(0, "3 nets verified in 0.10 s of CPU time")
    value, nets = machine_of(tmp_path, prover)
    assert value.phase is StartupPhase.CONFIGURE
    runs = (("one", "a"), ("one", "b"), ("two", "c"))
    assert value.missing() == [f"task {task} has not described its net {net}" for task, net in runs]
    describe(nets, [("/one", "a"), ("/one", "b"), ("/stranger", "c")])
    nets.described("/two", "c", json.dumps({"yaml": "net: c  # of a stranger"}))
    value.poll(0.0)
    assert value.missing() == ["task two has not described its net c"]
    assert prover.files == []
    (tmp_path / "nets").mkdir()
    (tmp_path / "nets" / "former.yaml").write_text("net: former")
    describe(nets, [("/two", "c")])
    value.poll(0.0)
    assert value.phase is StartupPhase.CONFIGURE
    assert value.missing() == ["nets a, b, c are still being verified together"]
    poll_until(value, lambda: value.phase is StartupPhase.START)
    assert prover.files == [["a.yaml", "b.yaml", "c.yaml"]]
    assert sorted(file.name for file in (tmp_path / "nets").iterdir()) == prover.files[0]
    assert nets.verdict == "3 nets verified in 0.10 s of CPU time"
    assert nets.proved


def test_nets_that_are_refused_stop_the_start_with_the_way_that_shows_it(tmp_path):
    said = "net a verified: 3 markings\nnets a, c are refused:\n  refused  it is stuck\n    after    a.x -> c.y"
    value, nets = machine_of(tmp_path, Prover(1, said), unproved=True)
    describe(nets)
    poll_until(value, lambda: value.state == machine.FAILED)
    assert value.phase is StartupPhase.CONFIGURE
    assert value.missing() == ["nets a, c are refused:", "  refused  it is stuck", "    after    a.x -> c.y"]
    value.poll(0.0)
    assert value.state == machine.FAILED


def test_a_verifier_that_fails_stops_the_start_with_its_last_words(tmp_path):
    value, nets = machine_of(tmp_path, Prover(2, "pnt: a.yaml:1:1: net: is missing"), unproved=True)
    describe(nets)
    poll_until(value, lambda: value.state == machine.FAILED)
    assert value.missing() == ["pnt: a.yaml:1:1: net: is missing"]


@pytest.mark.parametrize("unproved", [False, True])
def test_what_is_not_proved_starts_only_where_that_is_asked_for(tmp_path, unproved):
    said = "net a+c is not proved: whether it can get stuck: more than 10 markings"
    value, nets = machine_of(tmp_path, Prover(3, said), unproved=unproved)
    describe(nets)
    if unproved:
        poll_until(value, lambda: value.phase is StartupPhase.START)
        assert not nets.proved
        assert nets.verdict == f"started all the same: {said}"
    else:
        poll_until(value, lambda: value.state == machine.FAILED)
        assert value.missing() == [said]


def test_a_net_that_two_tasks_run_is_named(tmp_path):
    nets = MachineNets(tmp_path, unproved=True, prove=Prover(0, "fine"))
    value = bootstrap(tmp_path, nets=nets)
    for name in NAMES:
        value.heard(name, 7, 1, Progress.CONFIGURED, nets_sentence(["same"]), now=0.0)
    value.poll(0.0)
    value.poll(0.0)
    assert value.state == machine.FAILED
    assert value.missing() == ["net same is run by task one and by task two; a machine runs a net once"]


def test_what_is_no_description_and_what_names_no_net_is_not_taken(tmp_path):
    nets = MachineNets(tmp_path, unproved=False, prove=Prover(0, "fine"))
    nets.reported("/one", {"a": net_digest("net: a")})
    with pytest.raises(DataError, match="the description of net a"):
        nets.described("/one", "a", "{}")
    assert nets_told(nets_sentence(["a", "b_1"])) == ("a", "b_1")
    assert nets_told("nets: ../x, a b, ok") == ("ok",)
    assert nets_told("nothing was heard of it") == ()
    assert nets_sentence([]) == ""
