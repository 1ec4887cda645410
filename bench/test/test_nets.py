import sys
from pathlib import Path

import pytest

from bench.figures import measure
from bench.nets import firings, searches
from bench.nets.families import by_name, catching_philosophers, kanban, philosophers, ring
from bench.nets.peers import Peers, installed_peers, plain
from bench.nets.player import SYMBOL, Player, Work, working
from bench.nets.workers import Worker, number, own
from im_core.errors import LinkError
from im_pnt.errors import NetError
from im_pnt.model.compiled import compile_net
from im_pnt_analysis import verify_to_load
from im_pnt_node.journal.journal import Journal

NO_PEERS = Peers(None, Path(), "the peers could not be installed")


def brute_force(net):
    """Number of markings, and of those that are stuck."""
    compiled = compile_net(net)
    first = compiled.marking_vector(net.initial_marking())
    seen, todo, stuck = {first}, [first], 0
    while todo:
        marking = todo.pop()
        enabled = [t for t in range(len(compiled.transitions)) if compiled.enabled(marking, t)]
        stuck += not enabled
        for transition in enabled:
            after = compiled.fire(marking, transition)
            if after not in seen:
                seen.add(after)
                todo.append(after)
    return len(seen), stuck


def lucas(n):
    """Ways to choose from a round table so that no two neighbours are chosen."""
    a, b = 2, 1
    for _ in range(n):
        a, b = b, a + b
    return a


@pytest.mark.parametrize("seats", [2, 3, 6])
def test_philosophers_who_catch_forks_have_three_to_the_n_markings_and_two_deadlocks(seats):
    assert brute_force(catching_philosophers(seats)) == (3**seats, 2)


@pytest.mark.parametrize(("cards", "states"), [(1, 160), (2, 4600)])
def test_kanban_has_the_published_number_of_markings(cards, states):
    assert brute_force(kanban(cards)) == (states, 0)


@pytest.mark.parametrize("seats", [2, 3, 7])
def test_philosophers_who_take_both_forks_never_eat_next_to_each_other(seats):
    assert brute_force(philosophers(3 * seats)) == (lucas(seats) if seats > 2 else 3, 0)


@pytest.mark.parametrize("places", [2, 9])
def test_a_ring_has_a_marking_for_each_place(places):
    assert brute_force(ring(places)) == (places, 0)


@pytest.mark.parametrize("name", ["kanban:2", "catching_philosophers:8"])
def test_what_is_timed_is_the_whole_space(name):
    states, used = searches.search(by_name(name))
    assert states == searches.KNOWN[name]
    assert used > 0.0


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("kanbam:2", "there is no family of nets 'kanbam'.*kanban"),
        ("kanban", "family kanban needs a size"),
        ("kanban:0", "0 cards of a Kanban system: 1 to 100000 are possible"),
        ("ring:1", "1 places of a ring: 2 to 100000 are possible"),
    ],
)
def test_a_wrong_family_is_named(name, message):
    with pytest.raises(NetError, match=message):
        by_name(name)


@pytest.mark.parametrize("make", [ring, philosophers])
@pytest.mark.parametrize("work", list(Work))
@pytest.mark.parametrize("journal", [False, True])
def test_a_player_fires_as_often_as_it_says_for_a_command_and_keeps_its_tokens(make, work, journal, tmp_path):
    player = Player(working(make.__name__, 12, work), Journal(tmp_path, "bench") if journal else None)
    assert player.fire(100) >= 100
    marked = player.executor.marking()
    assert sum(marked.values()) == 1 if make is ring else 4 <= sum(marked.values()) <= 8
    rule = player.executor.rule
    owned = {place for place in marked if not place.startswith("fork")}
    assert owned
    for place in owned:
        assert [lineage.job.symbol for lineage in rule.tokens.queues[rule.place[place]]] == [SYMBOL]


@pytest.mark.parametrize("make", [ring, philosophers])
@pytest.mark.parametrize("work", list(Work))
def test_what_is_measured_is_a_net_that_may_run(make, work):
    assert verify_to_load([working(make.__name__, 12, work)]).ok


def test_an_observed_player_tells_of_every_firing():
    player = Player(working("philosophers", 12, Work.NONE))
    assert player.fire(50) == player.observer.count == player.executor.sequence


def test_our_own_process_fires_and_an_absent_peer_is_said_to_be_absent(tmp_path, monkeypatch):
    monkeypatch.setattr(firings, "SIZES", (10, 100))
    lines = firings.lines(NO_PEERS, 50, 2, tmp_path)
    assert len(lines) == 2 * (3 * 2 + 1 + 3)
    assert [line.value > 0 for line in lines] == [True] * len(lines)
    compared = [line for line in lines if line.against and line.against != "slowest"]
    assert len(compared) == 2 * (2 * 2 + 3)
    assert {line.against for line in compared} == {"the peers could not be installed"}
    spread = next(line for line in lines if "slowest" in line.name)
    assert spread.measure >= 1.0


@pytest.fixture
def workspace(tmp_path):
    """``workspace(requirement)``: one with another requirement of peers."""

    def write(requirement=""):
        requirements = tmp_path / "bench" / "peers" / "requirements.txt"
        requirements.parent.mkdir(parents=True, exist_ok=True)
        requirements.write_text(requirement)
        installed_peers.cache_clear()
        return installed_peers(tmp_path)

    yield write
    installed_peers.cache_clear()


def test_peers_are_installed_once(workspace, capfd):
    peers = workspace()
    assert peers.python is not None
    assert peers.python.exists()
    assert "installing the peers into" in capfd.readouterr().err
    assert workspace() == peers
    assert not capfd.readouterr().err
    assert workspace("# others") == peers
    assert "installing the peers into" in capfd.readouterr().err


def test_peers_that_cannot_be_installed_are_told_and_tried_again(workspace, capfd):
    for _ in range(2):
        peers = workspace("./no_such_folder")
        assert (peers.python, peers.missing) == (None, "the peers could not be installed into .venv-peers")
        assert "their rows say so" in capfd.readouterr().err
        with pytest.raises(LinkError, match="could not be installed into"):
            peers.start("snakes")


def test_peers_get_the_same_net():
    content = plain(ring(3))
    assert content["places"] == {"p0": 1, "p1": 0, "p2": 0}
    assert content["transitions"]["t2"] == [["p2"], ["p0"]]


def test_a_peer_program_speaks_the_protocol(tmp_path):
    serve = Path(__file__).parents[1] / "peers" / "serve.py"
    (tmp_path / "serve.py").write_text(serve.read_text())
    program = "from serve import serve\nprint('noise')\nserve(lambda net: lambda n: n + 1)\n"
    (tmp_path / "idle_peer.py").write_text(program)
    with Peers(Path(sys.executable), tmp_path).start("idle") as worker:
        assert worker.ask("load", net={}) == {}
        assert worker.ask("fire", firings=4)["firings"] == 5


def test_a_worker_that_dies_says_its_last_word():
    worker = Worker("broken", [sys.executable, "-c", "raise ValueError('no such net')"])
    with worker, pytest.raises(LinkError, match="broken ended with code 1: ValueError: no such net"):
        worker.ask("load")


def test_a_worker_that_is_silent_is_not_waited_for_for_ever():
    worker = Worker("deaf", [sys.executable, "-c", "import sys; sys.stdin.read()"])
    with worker, pytest.raises(LinkError, match=r"deaf does not answer in 0\.1 s"):
        worker.ask("load", patience=0.1)


def test_a_program_that_is_not_there_is_named():
    with pytest.raises(LinkError, match="nothing cannot be started: /no/such/program: No such file"):
        Worker("nothing", ["/no/such/program"])


def test_an_answer_that_is_no_number_is_refused():
    with own("bench.nets.player") as worker:
        assert worker.ask("load", family="ring", places=3, work="no action", folder="") == {}
        assert number(worker.ask("fire", firings=10), "firings") == 10.0
    with pytest.raises(LinkError, match="cpu_s='soon'"):
        number({"cpu_s": "soon"}, "cpu_s")


def test_a_group_that_fails_is_told_and_does_not_end_the_others(tmp_path):
    broken = tmp_path / "broken.yaml"
    broken.write_text("net: [")
    measured = measure({"verify": lambda: searches.shipped_lines([broken], tmp_path)}, ["verify"])
    assert measured.failed
    assert not measured.good
    assert "broken.yaml" in next(line.against for line in measured.lines if line.name == "verify")


@pytest.mark.parametrize(
    ("name", "said"), [("rings:3", "did you mean 'ring'"), ("ring:x", "needs a size"), ("ring:1", "2 to")]
)
def test_a_family_that_cannot_be_made_is_refused(name, said):
    with pytest.raises(NetError, match=said):
        by_name(name)
