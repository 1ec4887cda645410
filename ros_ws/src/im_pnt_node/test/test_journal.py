"""The journal of a process: what belongs to it, what comes back, and what is said of what does not."""

import json
import math
import random
from types import SimpleNamespace

import pytest

from im_core import clock
from im_core.errors import ImError, LinkError
from im_core.store_mark import SeenStore, StoreMark
from im_pnt.errors import JournalError
from im_pnt.execution.abandonment import abandonment
from im_pnt.execution.events import CommandCancelled, JobUpdate, JobUpdateArrived, RequestArrived, TokenArrived
from im_pnt.execution.executor import Executor
from im_pnt.execution.functions import ActionContext, Functions
from im_pnt.execution.jobs import Command, CommandResult, JobKey, Owner, Request, TokenContext
from im_pnt.execution.notification import Observer
from im_pnt.execution.runner import FunctionRunner
from im_pnt.model.action import FunctionAction, RequestAction, TopicAction
from im_pnt.netfile import parse_net
from im_pnt_node.distributed.entries import ReplyArrived
from im_pnt_node.distributed.packets import Message
from im_pnt_node.journal import journal, log
from im_pnt_node.journal.folder import Folder
from im_pnt_node.journal.journal import GuardedRunner, Journal, fingerprint
from im_pnt_node.journal.log import Sync
from support.journalled import JournalledProcess
from support.memory_files import MemoryFiles

LINE = "net: n\nplaces: {a: {tokens: 3, remote: true}, b: }\ntransitions: {t: {in: [a, a, a], out: b}}"


class Troubles(Observer):
    def __init__(self) -> None:
        self.texts: list[str] = []

    def troubled(self, net: str, text: str) -> None:
        self.texts.append(text)


class Pair:
    """Two processes with journals on a perfect network, which a test kills and brings back."""

    def __init__(self, **texts: list[str]) -> None:
        self.now = 0.0
        self.nets = {name: [parse_net(text) for text in of] for name, of in texts.items()}
        self.files = {name: MemoryFiles(name) for name in texts}
        self.troubles = Troubles()
        self.actions: dict = {}
        self.alive: dict[str, JournalledProcess] = {}
        self.flying: list[tuple[str, str]] = []
        for name in texts:
            self.start(name)

    def start(self, name: str) -> JournalledProcess:
        self.alive[name] = process = JournalledProcess(
            name,
            self.nets[name],
            self.files[name],
            actions=self.actions,
            transmit=lambda node, packet: self.flying.append((node, packet)),
            clock=lambda: self.now,
            observer=self.troubles,
        )
        return process

    def kill(self, name: str) -> None:
        del self.alive[name]
        self.files[name] = self.files[name].reborn()

    def lose_journal(self, name: str) -> None:
        self.files[name] = MemoryFiles(name)

    def run(self, seconds: float = 1.0) -> None:
        end = self.now + seconds
        while self.now < end:
            self.now += 0.05
            for process in list(self.alive.values()):
                process.turn()
                process.tick()
            flying, self.flying = self.flying, []
            for node, packet in flying:
                if node in self.alive:
                    self.alive[node].link.hear(packet)

    def marking(self, name: str) -> dict[str, int]:
        return self.alive[name].exchange.nets[name].marking()


def test_a_journal_of_when_data_objects_had_no_scopes_fits_a_net_without_any_and_is_refused_for_others():
    """The fingerprints are those that were written then; an object of the machine is another than one of a command."""
    text = "net: n\nplaces: {{a: 1, b: {shown}}}\ntransitions: {{t: {{in: a, out: b}}, u: {{in: b, out: a}}}}"
    assert fingerprint(parse_net(text.format(shown=""))) == "f9109674d797741c"
    assert fingerprint(parse_net(text.format(shown="{data_object: path}"))) != "95b7fecbeaa00bba"


def test_a_fingerprint_tells_nets_apart_that_behave_differently_and_no_others():
    net = parse_net(LINE)
    same = parse_net(f"# a remark\n\n{LINE}\ndescription: another one")
    assert fingerprint(net) == fingerprint(same)
    others = [LINE.replace("3", "2"), LINE.replace("a, a, a", "a, a"), LINE.replace("{t:", "{u:"), LINE + "\nrest: [b]"]
    assert len({fingerprint(parse_net(text)) for text in [LINE, *others]}) == 5


def test_another_net_another_node_and_another_process_are_refused():
    files = MemoryFiles()
    JournalledProcess("x", [parse_net(LINE)], files).turn()
    content = {name: bytes(text) for name, text in files.contents.items()}
    with pytest.raises(JournalError, match="the journal is in use"):
        JournalledProcess("x", [parse_net(LINE)], files)
    with pytest.raises(JournalError, match="this is the journal of x, not of y"):
        JournalledProcess("y", [parse_net(LINE)], files.reborn())
    changed, more = parse_net(LINE.replace("3", "6")), parse_net(LINE.replace("net: n", "net: m"))
    for nets, what in (
        ([changed], "net n was changed"),
        ([], "net n is missing"),
        ([parse_net(LINE), more], "net m is not in it"),
    ):
        with pytest.raises(JournalError, match=rf"belongs to other nets: {what}\. .*im pnt journal discard"):
            JournalledProcess("x", nets, files.reborn())
    assert {name: bytes(text) for name, text in files.contents.items()} == content
    assert JournalledProcess("x", [parse_net(LINE)], files.reborn()).recovered


def test_after_discard_everything_begins_anew_with_a_later_epoch(tmp_path):
    first = JournalledProcess("x", [parse_net(LINE)], Folder(tmp_path))
    first.turn()
    with pytest.raises(JournalError, match="is in use by process"):
        Journal.discard(tmp_path)
    first.journal.close()
    assert Journal.discard(tmp_path).startswith(str(tmp_path / "discarded-"))
    second = JournalledProcess("x", [parse_net(LINE)], Folder(tmp_path))
    assert not second.recovered
    assert second.journal.epoch > first.journal.epoch
    second.journal.close()
    third = JournalledProcess("x", [parse_net(LINE)], Folder(tmp_path))
    assert third.recovered
    assert third.journal.epoch == second.journal.epoch
    third.journal.close()


POWER_LOST = "; if the computer lost its power, more may be missing, and an action that began may begin again"


@pytest.mark.parametrize(("sync", "more"), [(Sync.OS, POWER_LOST), (Sync.DISK, "")])
def test_a_torn_last_record_is_dropped_and_said(sync, more):
    files = MemoryFiles()
    process = JournalledProcess("x", [parse_net(LINE)], files)
    process.turn()
    assert process.exchange.nets["n"].marking() == {"b": 1}
    name = files.names()[-1]
    del files.contents[name][-3:]
    troubles = Troubles()
    size = len(files.contents[name])
    again = JournalledProcess("x", [parse_net(LINE)], files.reborn(), observer=troubles, sync=sync)
    assert again.exchange.nets["n"].marking() == {"a": 3}
    start = files.contents[name].rindex(b"\n") + 1
    assert troubles.texts == [
        f"memory/{name}: what was written last, from byte {start} on, is not whole ({size - start} bytes) "
        f"and is dropped{more}"
    ]
    again.turn()
    assert again.exchange.nets["n"].marking() == {"b": 1}


@pytest.mark.parametrize("compacted", [False, True])
def test_the_last_transaction_of_the_object_store_is_remembered_with_what_happened(compacted):
    files, seen = MemoryFiles(), SeenStore()
    process = JournalledProcess("x", [parse_net(LINE)], files, store=seen)
    seen.mark = StoreMark("a", 8)
    process.turn()
    size = process.journal._log.size
    seen.mark = StoreMark("a", 9)
    process.turn()  # nothing has happened: nothing is written
    assert process.journal._log.size == size
    if compacted:
        process.journal.compact()
    back = SeenStore()
    again = JournalledProcess("x", [parse_net(LINE)], files.reborn(), store=back)
    assert (again.recovered, back.mark) == (True, StoreMark("a", 9 if compacted else 8))


def test_cut_or_damaged_anywhere_a_process_comes_back_at_a_moment_that_was_or_begins_anew_and_keeps_the_file():
    files, moments = MemoryFiles(), []
    net = parse_net("net: n\nplaces: {a: 6, b: }\ntransitions: {t: {in: a, out: b, action: f, on_failure: b}}")
    process = JournalledProcess(
        "x", [net], files, actions={"f": lambda ctx: moments.append(process.exchange.nets["n"].marking())}
    )
    process.turn()
    moments += [{"a": 6}, process.exchange.nets["n"].marking()]
    name = files.names()[-1]
    whole = bytes(files.contents[name])
    dice = random.Random(0)
    back = anew = 0
    for offset in range(0, len(whole), 3):
        changed = bytes([whole[offset] ^ 1 << dice.randrange(8)])
        for damaged in (whole[:offset], whole[:offset] + changed + whole[offset + 1 :]):
            trial, troubles = MemoryFiles(), Troubles()
            trial.contents[name] = bytearray(damaged)
            again = JournalledProcess("x", [net], trial, actions={"f": lambda ctx: None}, observer=troubles)
            marking = again.exchange.nets["n"].marking()
            marking = {place.replace("in_doubt", "active"): count for place, count in marking.items()}
            assert marking in moments
            if again.recovered:
                back += 1
                continue
            anew += 1
            assert marking == {"a": 6}
            assert again.journal.epoch > process.journal.epoch
            (kept,) = (path for path in trial.contents if path.startswith("damaged-"))
            assert bytes(trial.contents[kept]) == damaged
            (said,) = troubles.texts
            assert "record" in said
            assert f"it is kept in memory/{kept.partition('/')[0]}, and x begins anew" in said
    assert min(back, anew) > 0


def test_entries_that_do_not_fit_are_no_reason_to_crash():
    files = MemoryFiles()
    process = JournalledProcess("x", [parse_net(LINE)], files)
    process.turn()
    for entry in (
        ["net", "m", ["fire", "t", None]], ["net", "n", ["fire", "t", None]], ["net", "n", ["fire", "z", None]],
        ["net", "n", ["fire", "t"]], ["net", "n", ["end", 9, "t", None, None]], ["net", "n", ["end", 9]],
        ["net", "n", []], ["net", "n", [["x"]]], ["exchange", ["closed", "r"]], ["exchange", ["posted", "m", []]],
        ["exchange", ["asked", "r", "n", 1, "m", ""]], ["exchange", []],
        ["link", ["out", "y", 7, [7, "n", ["token", "p", 1, None]]]],
        ["link", ["out", "y", 1, [1, "n", ["token", "p", 1]]]],
        ["link", ["in", "y", 5, ""]], ["link", []], ["link", ["acked", "y", 3]], ["other"], [], 5, None, "x",
        ["exchange", ["posted", "n", ["request", [1]]]], ["exchange", ["undeliverable", 1, 2]], ["store", "a"],
    ):  # fmt: skip
        other = files.reborn()
        log = JournalledProcess("x", [parse_net(LINE)], other).journal._log
        log.append(json.dumps([entry]))
        with pytest.raises(JournalError, match=r"record 3 at byte \d+ does not fit what was before it"):
            JournalledProcess("x", [parse_net(LINE)], other.reborn())


FRONT = """
net: front
places: {idle: 1, asked: , good: , bad: }
transitions:
  begin: {in: idle, out: asked, symbol: go}
  ask: {in: asked, out: good, request: back.work, on_failure: bad}
  finish: {in: good, out: idle, emit: go_done}
  give_up: {in: bad, out: idle, emit: go_failed}
"""
BACK = """
net: back
places: {wanted: , good: , bad: , waiting: , go: {remote: true}}
services: {work: {entry: wanted, done: good, failed: bad}}
transitions:
  begin: {in: wanted, out: waiting}
  end: {in: [waiting, go], out: good, guard: not cancelled}
  stop: {in: waiting, out: bad, guard: cancelled}
"""


def asked(pair: Pair) -> list[CommandResult]:
    results: list[CommandResult] = []
    pair.alive["front"].exchange.nets["front"].command(Command(1, "go"), results.append)
    pair.run()
    assert pair.marking("front") == {"ask.active": 1}
    assert pair.marking("back").get("waiting") == 1
    return results


def let_go(pair: Pair) -> None:
    pair.alive["back"].exchange.nets["back"].post(TokenArrived("go", 1))


@pytest.mark.parametrize("dying", [["back"], ["front"], ["back", "front"]])
def test_a_request_survives_the_death_of_either_side(dying):
    pair = Pair(front=[FRONT], back=[BACK])
    asked(pair)
    for name in dying:
        pair.kill(name)
        others = list(pair.alive.values())
        for other in others:
            other.exchange.node_lost(name, f"{name} is missing")
        pair.run(10.0)
    for name in dying:
        pair.start(name)
    let_go(pair)
    pair.run(5.0)
    assert pair.marking("front") == {"idle": 1}
    assert pair.marking("back") == {"SI": 1, "SO": 1}
    assert not any(process.exchange.partners() for process in pair.alive.values())


def test_who_does_not_return_in_time_fails_what_waits_for_it_and_learns_of_it_when_it_returns():
    pair = Pair(front=[FRONT], back=[BACK])
    results = asked(pair)
    pair.kill("back")
    pair.alive["front"].exchange.node_lost("back", "back is missing")
    pair.run(59.0)
    assert results == []
    pair.run(2.0)
    assert isinstance(results[0].error, LinkError)
    assert str(results[0].error) == "back is missing; it has not returned in 60 s"
    pair.start("back")
    pair.run(5.0)
    assert pair.marking("back") == {"SI": 1, "SO": 1}
    assert pair.marking("front") == {"idle": 1}


def test_who_returns_without_its_journal_fails_what_waits_for_it_at_once():
    pair = Pair(front=[FRONT], back=[BACK])
    results = asked(pair)
    pair.kill("back")
    pair.lose_journal("back")
    pair.alive["front"].exchange.node_lost("back", "back is missing")
    pair.run(3.0)
    pair.start("back")
    pair.run(3.0)
    assert str(results[0].error).startswith("back came back without its journal; in flight were: ")
    assert pair.marking("back") == {"SI": 1, "SO": 1}


WAITER = """
net: waiter
places: {idle: 1, told: , bad: }
rest: [told, bad]
transitions: {wait: {in: idle, out: told, request: nobody.serve, on_failure: bad}}
"""


def test_no_request_has_the_name_of_one_that_an_old_copy_of_the_journal_has_forgotten():
    pair = Pair(front=[FRONT, WAITER], back=[BACK])
    asked(pair)
    let_go(pair)
    pair.run()
    old = pair.files["front"].reborn()
    first = pair.alive["front"].exchange.book.incarnation
    pair.alive["front"].exchange.nets["front"].command(Command(2, "go"))
    pair.run()
    forgotten = next(name for name, asked in pair.alive["front"].exchange.book.items() if asked.net == "back")
    pair.kill("front")
    pair.files["front"] = old
    pair.start("front")
    pair.run(5.0)
    assert any("the journal of front was an old copy" in text for text in pair.troubles.texts)
    pair.alive["front"].exchange.nets["front"].command(Command(3, "go"))
    pair.run()
    for _ in range(3):
        late = Message("front", ReplyArrived(forgotten, None, {"of": "the forgotten one"}))
        exchange = pair.alive["front"].exchange
        exchange.receive("back", late)
        pair.run()
        assert pair.marking("front") == {"ask.active": 1}
        lives = {name: [activity.begun_as for activity in net.activities] for name, net in exchange.nets.items()}
        assert lives == {"front": [""], "waiter": [f"{first}/waiter"]}  # what had begun before keeps its name
        assert exchange.book.incarnation != first
        pair.kill("front")
        pair.start("front")
        pair.run()
    let_go(pair)
    pair.run()
    assert pair.marking("front") == {"idle": 1}


@pytest.mark.parametrize("dying", [[], ["back"], ["front"], ["back", "front"]])
def test_a_cancellation_is_not_lost(dying):
    pair = Pair(front=[FRONT], back=[BACK])
    asked(pair)
    pair.flying.clear()
    front = pair.alive["front"]
    front.exchange.nets["front"].post(CommandCancelled(1, ImError("enough", code="cancelled")))
    front.turn()
    pair.flying.clear()  # the message is lost too
    for name in dying:
        pair.kill(name)
        pair.start(name)
    pair.run(5.0)
    assert pair.marking("back") == {"SI": 1, "SO": 1}
    assert pair.marking("front") == {"idle": 1}


@pytest.mark.parametrize("dying", [[], ["back"], ["front"], ["back", "front"]])
def test_an_abandoned_command_stays_so_in_both_processes_and_their_journals_say_what_it_held(dying):
    pair = Pair(front=[FRONT], back=[BACK])
    asked(pair)
    pair.flying.clear()
    front = pair.alive["front"]
    (job,) = front.exchange.nets["front"].jobs()
    error = abandonment(front.exchange.nets.values(), job.command, "abandoned by the operator")
    front.exchange.nets["front"].post(CommandCancelled(1, error))
    front.turn()
    assert pair.marking("front") == {"idle": 1}
    assert b"abandoned by the operator; under way" in b"".join(map(bytes, pair.files["front"].contents.values()))
    pair.flying.clear()  # the message is lost too
    for name in dying:
        pair.kill(name)
        pair.start(name)
    pair.run(5.0)
    assert b"it held: back.waiting" in b"".join(map(bytes, pair.files["back"].contents.values()))
    for _ in range(2):
        assert pair.marking("front") == {"idle": 1}
        assert pair.marking("back") == {"SI": 1, "SO": 1}
        assert not any(each.exchange.nets[name].jobs() for name, each in pair.alive.items())
        assert not pair.alive["front"].exchange.book.items()
        for name in ("front", "back"):  # once more, now from what the first death left
            pair.kill(name)
            pair.start(name)
        pair.run()


def test_a_token_that_nobody_wants_is_kept_counted_and_said():
    sends = "net: sends\nplaces: {a: 2, b: }\ntransitions: {t: {in: a, out: [b, gets.nowhere]}}"
    gets = "net: gets\nplaces: {p: {tokens: 1, remote: true}, q: }\ntransitions: {t: {in: [p, p], out: q}}"
    pair = Pair(sends=[sends], gets=[gets])
    pair.run(3.0)
    for _ in range(2):
        exchange = pair.alive["sends"].exchange
        assert {str(place): count for place, count in exchange.undeliverable.items()} == {"gets.nowhere": 2}
        assert pair.alive["sends"].link.idle()
        pair.kill("sends")
        pair.start("sends")
        pair.run(1.0)
    complaint = "a token for gets.nowhere is undeliverable and kept: net gets has no place nowhere (known: p, q)"
    assert pair.troubles.texts.count(complaint) == 2


def test_what_a_journal_cannot_keep_fails_the_action_that_made_it():
    text = """
net: n
places: {a: 1, b: , bad: }
transitions: {t: {in: a, out: b, action: f, on_failure: bad, symbol: go}}
"""
    for fill in (lambda ctx: ctx.memory.update(x=object()), lambda ctx: ctx.result.update(x=object())):
        process = JournalledProcess("x", [parse_net(text)], MemoryFiles(), actions={"f": fill})
        process.exchange.nets["n"].command(Command(1, "go"))
        process.turn()
        assert process.exchange.nets["n"].marking() == {"bad": 1}


def test_what_another_process_sends_and_a_journal_cannot_keep_is_refused_with_a_sentence():
    pair = Pair(front=[FRONT], back=[BACK])
    results = asked(pair)
    front, back = (pair.alive[name].exchange for name in ("front", "back"))
    ((request_id, _),) = front.book.items()
    unfit = ReplyArrived(request_id, None, {"score": math.nan})
    assert front.receive("back", Message("front", unfit)) == ""
    pair.alive["front"].turn()
    assert "the results for transition ask.score is nan" in str(results[0].error)
    asking = RequestArrived(Request("r", "back", "work", "", "other", "t", Command(), {"x": math.inf}))
    assert "arguments.x is inf" in back.receive("other", Message("back", asking))
    assert "r" not in back.inboxes.in_work
    owner = Owner(JobKey("other", "net", 1), "", Command(0, "go", {"x": math.nan}), {})
    token = TokenArrived("go", 1, TokenContext(owner, False, "", "net"))
    assert ".x is nan" in back.receive("other", Message("back", token))
    told = JobUpdateArrived(owner.key, False, JobUpdate.SETTLED, "net", None, {"x": math.nan})
    assert ".x is nan" in back.receive("other", Message("back", told))


def test_the_journal_grows_no_further_than_its_limit():
    loop = parse_net("net: n\nplaces: {a: 1, b: }\ntransitions: {t: {in: a, out: b, symbol: go}, u: {in: b, out: a}}")
    files = MemoryFiles()
    process = JournalledProcess("x", [loop], files, compact_bytes=5000)
    for number in range(500):
        process.exchange.nets["n"].command(Command(number, "go"))
        process.turn()
        assert sum(len(content) for content in files.contents.values()) < 12000
    assert len(files.names()) == 1
    sequence = process.exchange.nets["n"].sequence
    assert JournalledProcess("x", [loop], files.reborn()).exchange.nets["n"].sequence == sequence == 1000


def test_a_job_that_grows_is_not_written_whole_again():
    loop = parse_net(
        """
net: n
places: {idle: 1, a: , b: , bad: }
transitions:
  begin: {in: idle, out: a, symbol: go}
  pose: {in: a, out: b, action: pose, on_failure: bad}
  next: {in: b, out: a, guard: more}
  finish: {in: b, out: idle, guard: not more, emit: go_done}
"""
    )
    files = MemoryFiles()
    sizes: list[int] = []

    def pose(ctx: ActionContext) -> None:
        job = ctx.memory.setdefault("job", {"name": "x" * 1000, "poses": []})
        job["poses"].append({"number": len(job["poses"]), "joints": [0.1] * 6, "seen": False})
        job["poses"][-2:][0]["seen"] = True
        ctx.result["last"] = job["poses"][-1]["number"]
        sizes.append(sum(len(content) for content in files.contents.values()))

    guards = {"more": lambda ctx: len(sizes) < 200}
    process = JournalledProcess("x", [loop], files, actions={"pose": pose}, guards=guards)
    process.exchange.nets["n"].command(Command(1, "go", {"text": "y" * 1000}))
    process.turn()
    assert len(sizes) == 200
    assert sizes[-1] - sizes[100] < 1.1 * (sizes[100] - sizes[1])
    assert sizes[-1] < 200 * 500
    held = MemoryFiles()
    name = files.names()[-1]
    lines = bytes(files.contents[name]).splitlines(keepends=True)
    ends = [number for number, line in enumerate(lines) if b"pose.end" in line]
    held.contents[name] = bytearray(b"".join(lines[: ends[149] + 1]))
    back = JournalledProcess("x", [loop], held, actions={"pose": pose}, guards=guards)
    (job,) = back.exchange.nets["n"].jobs()
    assert [(pose["number"], pose["seen"]) for pose in job.memory["job"]["poses"]] == [
        (number, number < 149) for number in range(150)
    ]
    assert job.results == {"last": 149}


def test_while_the_journal_cannot_be_written_nothing_leaves_and_afterwards_all():
    sends = "net: sends\nplaces: {a: 2, b: }\ntransitions: {t: {in: a, out: [b, gets.p]}}"
    gets = "net: gets\nplaces: {p: {remote: true}, q: }\ntransitions: {t: {in: p, out: q}}"
    pair = Pair(sends=[sends], gets=[gets])
    for name, other in (("sends", "gets"), ("gets", "sends")):  # they have met
        lives = [other, pair.alive[other].link.epoch, 1, name, pair.alive[name].link.epoch]
        pair.alive[name].link.hear(json.dumps([*lives, 1, 0]))
        pair.alive[name].journal.commit()
    assert pair.flying == []
    for name, marking in (("sends", {}), ("gets", {"q": 2})):
        process, files = pair.alive[name], pair.files[name]
        files.full = True
        for _, packet in pair.flying:
            process.link.hear(packet)
        pair.flying.clear()
        with pytest.raises(JournalError, match="No space left"):
            process.turn()
        pair.now += 10.0
        process.link.tick()
        process.link.flush()
        assert pair.flying == []
        files.full = False
        process.turn()
        assert pair.alive["gets"].exchange.nets["gets"].marking() == marking
    pair.run(3.0)
    assert pair.marking("gets") == {"q": 2}
    assert all(process.link.idle() for process in pair.alive.values())


def test_more_than_a_record_holds_is_written_as_a_snapshot_once_it_can_be_written(monkeypatch):
    for module in (journal, log):
        monkeypatch.setattr(module, "MOST_BYTES", 2000)
    loop = parse_net("net: n\nplaces: {a: 1, b: }\ntransitions: {t: {in: a, out: b, symbol: go}, u: {in: b, out: a}}")
    files = MemoryFiles()
    process = JournalledProcess("x", [loop], files)
    files.full = True
    for number in range(1, 51):
        process.exchange.nets["n"].command(Command(number, "go"))
        with pytest.raises(JournalError, match="cannot be written"):
            process.turn()
    files.full = False
    process.turn()
    assert not process.journal.unwritten
    sequence = process.exchange.nets["n"].sequence
    assert JournalledProcess("x", [loop], files.reborn()).exchange.nets["n"].sequence == sequence == 100


def test_what_json_cannot_carry_now_only_delays_the_compaction():
    text = """
net: n
places: {a: 1, b: , c: , bad: }
transitions:
  t: {in: a, out: b, action: hold, on_failure: bad, symbol: go}
"""
    files, troubles = MemoryFiles(), Troubles()

    async def hold(ctx: ActionContext) -> None:
        ctx.memory["x"] = object()

    process = JournalledProcess(
        "x", [parse_net(text)], files, actions={"hold": hold}, observer=troubles, compact_bytes=0
    )
    process.exchange.nets["n"].command(Command(1, "go"))
    process.turn()
    assert process.exchange.nets["n"].marking() == {"bad": 1}
    again = JournalledProcess("x", [parse_net(text)], files.reborn(), actions={"hold": hold})
    assert again.exchange.nets["n"].marking() == {"bad": 1}


def test_where_the_journal_cannot_be_written_nothing_begins():
    net = parse_net("net: n\nplaces: {a: 1, b: , bad: }\ntransitions: {t: {in: a, out: b, action: f, on_failure: bad}}")
    files, done = MemoryFiles(), []

    def act(ctx: ActionContext) -> None:
        done.append(1)

    process = JournalledProcess("x", [net], files, actions={"f": act})
    files.full = True
    with pytest.raises(JournalError, match="No space left"):
        process.turn()
    assert done == []
    files.full = False
    process.turn()
    assert JournalledProcess("x", [net], files.reborn(), actions={"f": act}).exchange.nets["n"].marking() == {"bad": 1}


def test_who_asks_for_something_new_hears_of_a_full_disk_at_once():
    net = parse_net("net: n\nplaces: {a: 1, b: }\ntransitions: {t: {in: a, out: b, symbol: go}}")
    files = MemoryFiles()
    process = JournalledProcess("x", [net], files)
    process.journal.require_writable()
    files.full = True
    for _ in range(3):
        with pytest.raises(JournalError, match="No space left"):
            process.journal.require_writable()
    files.full = False
    process.journal.require_writable()
    process.exchange.nets["n"].command(Command(1, "go"))
    process.turn()
    assert JournalledProcess("x", [net], files.reborn()).exchange.nets["n"].marking() == {"b": 1}


def test_the_file_of_a_net_that_was_succeeded_takes_nothing_more():
    """What happens in the new net does not fit the old one: who came back from both would not come back."""
    net = parse_net("net: n\nplaces: {a: 1, b: }\ntransitions: {t: {in: a, out: b, symbol: go}}")
    other = parse_net("net: n\nplaces: {a: 1, c: }\ntransitions: {u: {in: a, out: c, symbol: go}}")
    files = MemoryFiles()
    process = JournalledProcess("x", [net], files)
    files.full = True
    functions = Functions()
    runner = process.journal.guard(FunctionRunner(functions, process.exchange, lambda work: work.close()))
    new = Executor(other, functions, runner, process.exchange, record=process.journal.recorder("n"))
    process.exchange.succeed(new)
    with pytest.raises(JournalError, match="No space left"):
        process.journal.renew()
    assert process.journal.unwritten
    new.command(Command(1, "go"))
    with pytest.raises(JournalError, match="No space left"):
        process.turn()
    assert JournalledProcess("x", [net], files.reborn()).exchange.nets["n"].marking() == {"a": 1}
    files.full = False
    process.turn()
    assert JournalledProcess("x", [other], files.reborn()).exchange.nets["n"].marking() == {"c": 1}


def test_a_snapshot_that_finds_no_room_leaves_the_old_file_and_keeps_nobody_from_going_on():
    loop = parse_net("net: n\nplaces: {a: 1, b: }\ntransitions: {t: {in: a, out: b, symbol: go}, u: {in: b, out: a}}")
    files, troubles = MemoryFiles(), Troubles()
    process = JournalledProcess("x", [loop], files, compact_bytes=2000, observer=troubles)
    create = files.create

    def no_room(name):
        raise OSError(28, "No space left on device")

    files.create = no_room
    for number in range(100):
        process.exchange.nets["n"].command(Command(number, "go"))
        process.turn()
    assert any("is not compacted now: " in text for text in troubles.texts)
    assert JournalledProcess("x", [loop], files.reborn()).exchange.nets["n"].sequence == 200
    files.create = create
    for number in range(100, 500):
        process.exchange.nets["n"].command(Command(number, "go"))
        process.turn()
    assert len(files.names()) == 1
    assert sum(len(content) for content in files.contents.values()) < 30_000


def test_no_action_of_any_kind_begins_before_the_journal_is_written():
    steps: list[str] = []

    class Runner:
        watch = waits = ask = None

        def start(self, executor, activity, context) -> None:
            steps.append(f"start {activity.action}")

        def direct(self, action):
            return lambda context: steps.append(f"call {action}")

    runner = GuardedRunner(Runner(), lambda: steps.append("write"))
    for action in (TopicAction("/t", "p/msg/T"), RequestAction("m", "s")):
        runner.start(None, SimpleNamespace(action=action), None)
    runner.direct(FunctionAction("f"))(None)
    assert steps == ["write", "start topic /t", "start request m.s", "write", "call function f"]


POWER = """
net: power
places: {idle: 1, a: , b: , c: , d: , bad: }
transitions:
  begin: {in: idle, out: a, symbol: go}
  plain: {in: a, out: b, action: plain, on_failure: bad}
  slow: {in: b, out: c, action: slow, on_failure: bad}
  ask: {in: c, out: [d, other.p], request: other.work, on_failure: bad}
"""


@pytest.mark.parametrize("compact_bytes", [0, 1 << 30])
def test_with_journal_sync_disk_nothing_begins_or_leaves_that_a_loss_of_power_makes_forgotten(compact_bytes):
    files, known = MemoryFiles(), []

    def remembered() -> list[str]:
        """What runs, and what is on its way, after the power is lost now and comes back."""
        silent = {"plain": lambda ctx: None, "slow": hold}
        back = JournalledProcess("x", [parse_net(POWER)], files.unplugged(), actions=silent, sync=Sync.DISK)
        running = [activity.transition for activity in back.exchange.nets["power"].activities]
        return running + [str(message) for messages in back.link.in_flight().values() for message in messages]

    async def hold(ctx: ActionContext) -> None:
        """Goes on for ever, as far as its process is concerned."""

    def plain(ctx: ActionContext) -> None:
        known.append(("plain", remembered()))

    async def slow(ctx: ActionContext) -> None:
        known.append(("slow", remembered()))

    def transmit(node: str, packet: str) -> None:
        known.append(("packet", remembered()))

    process = JournalledProcess(
        "x",
        [parse_net(POWER)],
        files,
        actions={"plain": plain, "slow": slow},
        transmit=transmit,
        compact_bytes=compact_bytes,
        sync=Sync.DISK,
    )
    process.exchange.nets["power"].command(Command(1, "go"))
    process.turn()
    assert [what for what, _ in known] == ["plain", "slow", "packet"]
    assert known[0][1] == ["plain"]
    assert known[1][1] == ["slow"]
    assert known[2][1][0] == "ask"
    assert known[2][1][1].startswith("request x-")


def test_a_journal_that_is_old_is_begun_anew_at_a_size_at_which_a_young_one_is_not(monkeypatch):
    now = [1000.0]
    monkeypatch.setattr(clock, "monotonic", lambda: now[0])
    monkeypatch.setattr(journal, "COMPACT_SOON_BYTES", 5000)
    loop = parse_net("net: n\nplaces: {a: 1, b: }\ntransitions: {t: {in: a, out: b, symbol: go}, u: {in: b, out: a}}")
    files = MemoryFiles()
    process = JournalledProcess("x", [loop], files)
    numbers = iter(range(10_000))

    def turn():
        process.exchange.nets["n"].command(Command(next(numbers), "go"))
        process.turn()

    while len(files.contents["000001.journal"]) < 10_000:
        turn()
    assert files.names() == ["000001.journal"], "it is young"
    now[0] += journal.COMPACT_PERIOD_S + 1.0
    turn()
    assert files.names() == ["000002.journal"]
    now[0] += journal.COMPACT_PERIOD_S + 1.0
    turn()
    assert files.names() == ["000002.journal"], "it is small"
