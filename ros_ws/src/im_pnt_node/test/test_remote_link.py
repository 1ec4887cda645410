"""The streams between two processes: each message once and in order; lives, refusals, and packets of an enemy."""

import json
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_core.errors import DataError
from im_pnt.errors import NetError
from im_pnt.execution.events import JobUpdate, JobUpdateArrived, RequestArrived, RequestHeld, TokenArrived
from im_pnt.execution.jobs import Command, JobKey, Request
from im_pnt.execution.notification import Observer
from im_pnt_node.distributed.codec import LINK_ENTRY
from im_pnt_node.distributed.entries import LinkEntry, ReplyArrived
from im_pnt_node.distributed.link import MANY_UNPROVED, MOST_PEERS, MOST_STRANGERS, Link
from im_pnt_node.distributed.packets import (
    MOST_EPOCH,
    SECRET_BITS,
    VOID,
    Message,
    decode_message,
    encode_message,
    new_epoch,
)
from im_pnt_node.distributed.streams import WINDOW
from im_pnt_node.journal.state import link_state, restore_link


class Troubles(Observer):
    def __init__(self) -> None:
        self.texts: list[str] = []
        self.silent: list[str] = []

    def troubled(self, net: str, text: str) -> None:
        self.texts.append(text)

    def unreached(self, node: str, text: str) -> None:
        self.silent.append(text)


class End:
    """One end of a wire: what it got, and what it has sent."""

    def __init__(self, name: str, epoch: int, journal: bool = True) -> None:
        self.first_epoch = epoch
        self.now = 0.0
        self.entries: list[str] = []
        self.got: list[Message] = []
        self.returned: list[tuple[Message, str]] = []
        self.resets: list[tuple[str, str, list[Message]]] = []
        self.packets: list[tuple[str, str]] = []
        self.observer = Troubles()
        self.refuses = ""
        self.link = Link(
            name,
            epoch,
            self.accept,
            lambda message, why: self.returned.append((message, why)),
            lambda node, why, in_flight: self.resets.append((node, why, in_flight)),
            lambda node: None,
            lambda node, packet: self.packets.append((node, packet)),
            self.observer,
            clock=lambda: self.now,
        )
        if journal:
            self.link.record = self.record

    def record(self, entry: LinkEntry) -> None:
        self.entries.append(LINK_ENTRY.encode(entry))

    def accept(self, sender: str, message: Message) -> str:
        if self.refuses and place_of(message) == self.refuses:
            return f"there is no place {place_of(message)}"
        self.got.append(message)
        return ""

    def reborn(self, name: str) -> "End":
        """The same process after its death, brought back by its journal alone."""
        other = End(name, self.first_epoch, journal=False)
        other.now, other.got, other.refuses = self.now, list(self.got), self.refuses
        for entry in [f'["epoch",{self.first_epoch}]', *self.entries]:
            other.link.replay(LINK_ENTRY.decode(json.loads(entry)))
        other.link.come_back()
        other.entries = list(self.entries)
        other.link.record = other.record
        return other

    def send(self, node: str, *places: str) -> None:
        for place in places:
            self.link.send(node, token(place))

    def taken(self) -> list[str]:
        return [place_of(message) for message in self.got]


def token(place: str) -> Message:
    return Message("net", TokenArrived(place, 1))


def place_of(message: Message) -> str:
    return message.event.place if isinstance(message.event, TokenArrived) else ""


def request(request_id: str, **arguments: object) -> Message:
    asked = Request(request_id, "net", "s", "", "c", "t", Command(7), arguments)
    return Message("net", RequestArrived(asked))


def exchange(
    *ends: End, keep=lambda packet: True, seconds: float = 0.1, strangers: bool = False, rest: bool = True
) -> None:
    """Carries packets until nothing is sent any more; what is for others than the ends is dropped, if it may be."""
    by_name = {end.link.name: end for end in ends}
    for _ in range(1000 if rest else 30):
        for end in ends:
            end.now += seconds
            end.link.tick()
        flying = [item for end in ends for item in end.packets]
        for end in ends:
            end.packets.clear()
        for node, packet in flying:
            if keep(packet) and not (strangers and node not in by_name):
                by_name[node].link.hear(packet)
        if not flying and all(end.link.idle() for end in ends):
            return
    assert not rest, "the ends do not come to rest"


def pair() -> tuple[End, End]:
    return End("a", 1), End("b", 1)


def met() -> tuple[End, End]:
    """Two processes that know each other's lives."""
    a, b = pair()
    a.link.hear(packet("b", 1, 1, "a", 1))
    b.link.hear(packet("a", 1, 1, "b", 1))
    return a, b


def test_messages_arrive_once_and_in_order_whatever_is_lost():
    a, b = pair()
    dice = random.Random(1)
    a.send("b", *"xyz")
    b.send("a", *"uvw")
    exchange(a, b, keep=lambda packet: dice.random() < 0.4)
    assert b.taken() == list("xyz")
    assert a.taken() == list("uvw")


def test_nothing_leaves_before_the_flush_and_no_acknowledgement_before_its_journal():
    a, b = met()
    a.send("b", "x")
    assert a.packets == []
    a.link.flush()
    b.link.hear(a.packets[0][1])
    assert b.packets == []
    assert [json.loads(entry)[0] for entry in b.entries] == ["begin", "in"]


@settings(max_examples=60, deadline=None)
@given(st.lists(st.sampled_from(["send", "a->b", "b->a", "a dies", "b dies", "drop", "wait"]), max_size=60))
def test_death_and_return_at_any_time_neither_lose_nor_double(steps):
    a, b = pair()
    sent: list[str] = []
    for step in steps:
        if step == "send":
            sent.append(str(len(sent)))
            a.send("b", sent[-1])
            b.send("a", sent[-1])
        elif step == "a dies":
            a = a.reborn("a")
        elif step == "b dies":
            b = b.reborn("b")
        elif step == "drop":
            a.packets.clear()
        elif step == "wait":
            for end in (a, b):
                end.now += 1.0
                end.link.tick()
        else:
            source, target = (a, b) if step == "a->b" else (b, a)
            source.link.tick()
            for _, packet in source.packets:
                target.link.hear(packet)
            source.packets.clear()
    exchange(a, b)
    assert a.taken() == sent
    assert b.taken() == sent
    assert a.resets == b.resets == []


def test_a_snapshot_is_as_good_as_the_entries():
    a, b = met()
    b.refuses = "no"
    a.send("b", "x", "no", "y")
    a.link.flush()
    b.link.hear(a.packets[0][1])
    for end in (a, b):
        other, third = end.reborn(end.link.name), End(end.link.name, 5)
        restore_link(third.link, json.loads(json.dumps(link_state(end.link))))
        assert link_state(other.link) == link_state(third.link) == link_state(end.link)


def test_a_refused_message_returns_once_even_if_everybody_dies_meanwhile():
    a, b = met()
    b.refuses = "no"
    a.send("b", "x", "no", "y")
    a.link.flush()
    b.link.hear(a.packets[0][1])
    b = b.reborn("b")
    a = a.reborn("a")
    b.refuses = ""  # whatever it would say now, it has been refused
    exchange(a, b)
    assert b.taken() == ["x", "y"]
    assert a.returned == [(token("no"), "there is no place no")]
    assert link_state(b.link)["peers"]["a"]["heard"][1] == 3
    a.send("b", "z")
    exchange(a, b)
    assert link_state(b.link)["peers"]["a"]["heard"][2] == []


def test_more_refusals_than_one_acknowledgement_tells_all_return():
    a, b = pair()
    b.refuses = "no"
    a.send("b", *["no"] * 300, "yes")
    exchange(a, b)
    assert len(a.returned) == 300
    assert b.taken() == ["yes"]


def test_who_lost_its_journal_begins_anew_and_the_other_side_says_what_was_in_flight():
    a, b = pair()
    a.send("b", "x")
    b.send("a", "u")
    exchange(a, b)
    a.send("b", "y")
    a.link.send("b", request("r-1"))
    late = End("b", 2)
    late.send("a", "v")
    late.link.flush()
    exchange(a, late)
    assert a.resets[0][:2] == ("b", "b came back without its journal")
    assert [str(message) for message in a.resets[0][2]] == ["a token for net.y", "request r-1 to net net"]
    assert late.taken() == [
        "y",
        "",
    ]  # the token is given to its new incarnation, and nothing in the place of the request
    assert late.got[1] == VOID
    assert a.taken() == ["u", "v"]


def test_messages_of_an_earlier_life_are_not_taken():
    a, b = pair()
    a.send("b", "old")
    a.link.flush()
    stale = a.packets[0][1]
    new = End("a", 2)
    new.send("b", "new")
    exchange(new, b)
    b.link.hear(stale)
    assert b.taken() == ["new"]


def test_a_message_meant_for_another_life_of_the_receiver_is_not_taken_twice():
    a, b = pair()
    a.send("b", "x")
    exchange(a, b)
    a.send("b", "y")
    a.link.flush()
    delayed = a.packets.pop()[1]
    a.now += 1.0
    a.link.tick()
    exchange(a, b)
    late = End("b", 2)
    late.link.hear(delayed)
    exchange(a, late)
    assert b.taken() == ["x", "y"]
    assert late.taken() == []


def test_a_process_whose_clock_went_back_becomes_the_later_one():
    a, b = End("a", 1000), End("b", 1)
    a.send("b", "x")
    exchange(a, b)
    back = End("a", 5)
    back.send("b", "y", "z")
    exchange(back, b)
    assert b.taken() == ["x", "y", "z"]
    assert back.link.epoch > 1000
    assert back.link.epoch % 2**SECRET_BITS not in (0, 1, 1001)


def test_what_nobody_needs_any_more_leaves_no_gap():
    a, b = met()
    a.send("b", "x")
    a.link.send("b", request("r-1"))
    a.send("b", "y")
    a.link.forget("r-1")
    exchange(a, b)
    assert b.got == [token("x"), VOID, token("y")]


def test_while_a_process_is_silent_only_a_window_is_on_its_way():
    a, b = pair()
    a.send("b", *map(str, range(3 * WINDOW)))
    a.link.flush()
    a.now += 10.0
    a.link.tick()
    numbers = {entry[0] for _, packet in a.packets for entry in json.loads(packet)[7:]}
    assert numbers == set(range(1, WINDOW + 1))
    exchange(a, b)
    assert b.taken() == list(map(str, range(3 * WINDOW)))


def packet(sender="x", epoch=7, journal=0, receiver="a", known=0, base=1, ack=0, *messages) -> str:
    return json.dumps([sender, epoch, journal, receiver, known, base, ack, *messages])


HOSTILE = [
    "", "[", "null", "[]", "{}", "[" * 100_000, '"' + "x" * 10_000, "\0", "NaN", '[1e999]', "9" * 10_000,
    packet(sender=""), packet(sender="x" * 10_000), packet(sender="../x"), packet(sender="x y"), packet(sender=5),
    packet(epoch=0), packet(epoch=-1), packet(epoch=2**80), packet(epoch=1.5), packet(epoch=True), packet(epoch=None),
    packet(base=0), packet(base=-5), packet(base="1"), packet(known=-1), packet(known=2**62), packet(journal="yes"),
    packet(known=1, ack=[5, []]), packet(known=1, ack=[-1, []]), packet(known=1, ack=[0, [[1, "no"], [2], 3, {}]]),
    packet("x", 7, 0, "a", 1, 1, {"a": 1}), packet("x", 7, 0, "a", 1, 1, [2**70, []]), packet("x", 7, 0, "b"),
    packet("x", 7, 0, "a", 0, 1, 0, [1]), packet("x", 7, 0, "a", 0, 1, 0, [2, "n"]),
    packet("x", 7, 0, "a", 0, 1, 0, 5), packet("x", 7, 0, "a", 0, 1, 0, [3, "n", ["odd", "p", 1, None]]),
    packet("x", 7, 0, "a", 0, 1, 0, [-4, "n", ["token", "p", 1, None]]),
    packet("x", 7, 0, "a", 0, 1, 0, ["1", "n", ["token", "p", 1, None]]),
    packet("x", 7, 0, "a", 0, 1, 0, [1, "n", ["token", "p", 1, None], 4, 5, 6]),
    packet("x", 7, 0, "a", 1, 1, 0, [1, "n", ["token", "p", 2**70, None]]), packet("x", 7, 0, "a", 1, 1, 0, [1, "n"]),
    packet("x", 7, 0, "a", 1, 1, 0, [1, "n", ["request", ["r", "n", "s", "", "", "", [-1, "", {}, 0, ""], {}], False]]),
    packet("x", 7, 0, "a", 1, 1, 0, [1, "n", ["tiding", ["p", "n", 1], False, "odd", "m", None, {}]]),
]  # fmt: skip


@pytest.mark.parametrize("text", HOSTILE, ids=range(len(HOSTILE)))
def test_packets_that_make_no_sense_do_no_harm(text):
    a, b = pair()
    a.send("b", "x")
    exchange(a, b)
    epoch = a.link.epoch
    for _ in range(3):
        a.link.hear(text)
        a.now += 0.1
        a.link.tick()
    a.packets.clear()
    assert a.got == []
    assert a.link.epoch == epoch
    a.send("b", "y")
    exchange(a, b)
    assert b.taken() == ["x", "y"]
    json.dumps(link_state(a.link))
    a.reborn("a")


json_values = st.recursive(
    st.none() | st.booleans() | st.integers(-3, 8) | st.integers() | st.floats() | st.sampled_from("abxn"),
    lambda inner: st.lists(inner, max_size=6) | st.dictionaries(st.text(max_size=2), inner, max_size=2),
    max_leaves=12,
)


@settings(max_examples=100, deadline=None)
@given(st.lists(json_values, max_size=9), st.integers(0, 9))
def test_fuzzed_packets_of_who_knows_the_epoch_break_nothing(fields, kept):
    a, _ = pair()
    a.send("b", "x")
    valid = json.loads(packet("x", 7, 0, "a", 1, 1, 0, [1, "n", ["token", "p", 1, None]]))
    a.link.hear(json.dumps(valid[:kept] + fields))
    a.link.tick()
    assert link_state(a.reborn("a").link) == link_state(a.link)


def test_a_flood_of_senders_and_of_numbers_is_bounded():
    a, b = pair()
    for number in range(3 * MOST_PEERS):
        a.link.hear(packet(sender=f"x{number}", known=1))
    assert len(link_state(a.link)["peers"]) == MOST_PEERS
    c = End("c", 1)
    for number in range(2, 10 * WINDOW):
        c.link.hear(packet("x", 7, 0, "c", 1, 1, 0, [number, "net", ["token", "p", 1, None]]))
    assert c.got == []
    c.link.hear(packet("x", 7, 0, "c", 1, 1, 0, [1, "net", ["token", "p", 1, None]]))
    assert len(c.got) == WINDOW
    for _ in range(1000):
        b.link.hear(packet("x", 7, 0, "b", 1, 1, [12345, []]))
    assert len(link_state(b.link)["peers"]) == 1
    assert "acknowledged [12345, []], and 0 messages were sent to it" in b.observer.texts[0]


# Attackers who read nothing: they know names and nets, the code and the clock, and not the epochs.

NUMBERS = st.sampled_from([0, 1, 2, 3, WINDOW, WINDOW + 5, 10**9, 2**62 - 1, 2**64, MOST_EPOCH - 1]) | st.integers(0, 8)
ACKS = st.sampled_from([0, 1]) | st.tuples(NUMBERS, st.lists(st.tuples(NUMBERS, st.just("no")), max_size=2))
MESSAGES = st.lists(
    st.tuples(NUMBERS, st.just("net"), st.just(["token", "forged", 1, None]))
    | st.tuples(NUMBERS, st.just("net"), st.just(["reply", "r-1", None, {}]))
    | st.tuples(NUMBERS, st.just(""), st.none()),
    max_size=3,
)
EPOCHS = NUMBERS | st.builds(lambda ahead: new_epoch() + (ahead << SECRET_BITS), st.integers(0, 10**12))
FORGED = st.builds(
    lambda fields, messages: packet(*fields, *messages),
    st.tuples(st.sampled_from(["a", "b", "x"]), EPOCHS, st.integers(0, 1), st.just("?"), EPOCHS, NUMBERS, ACKS),
    MESSAGES,
)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.sampled_from(["a", "b"]), st.integers(0, 7), FORGED), max_size=12), st.booleans())
def test_forged_packets_take_hide_and_block_nothing(forged, early):
    a, b = End("a", new_epoch()), End("b", new_epoch())
    ends = {"a": a, "b": b}
    epochs = a.link.epoch, b.link.epoch
    if not early:
        a.send("b", "0")
        exchange(a, b)
    before = 0 if early else 1
    for number in range(before, 8):
        a.send("b", str(number))
        b.send("a", str(number))
        a.link.flush()
        for target, when, text in forged:
            if when == number:
                ends[target].link.hear(text.replace('"?"', f'"{target}"'))
        exchange(a, b, strangers=True)
    assert b.taken() == [str(number) for number in range(8)]
    assert a.taken() == [str(number) for number in range(before, 8)]
    assert (a.link.epoch, b.link.epoch) == epochs
    assert a.resets == b.resets == a.returned == b.returned == []
    assert set(link_state(a.link)["peers"]) <= {"b"}
    assert set(link_state(b.link)["peers"]) <= {"a"}


def test_the_packets_that_once_did_harm_do_none_and_are_told_of():
    a, b = End("a", new_epoch()), End("b", new_epoch())
    a.send("b", "x")
    exchange(a, b)
    for epoch in (2**62 - 1, MOST_EPOCH - 1, new_epoch(a.link.epoch)):
        b.link.hear(
            packet(
                "a",
                epoch,
                1,
                "b",
                0,
                1,
                0,
                [1, "net", ["token", "forged", 1, None]],
                [2, "net", ["token", "forged", 1, None]],
            )
        )
        b.link.hear(packet("a", epoch, 1, "b", 0, 10**9))
        a.link.hear(packet("b", 2**62 - 1, 1, "a", epoch, 1, [1, [[1, "no"]]]))
    assert "names an incarnation that begins" in b.observer.texts[0]
    a.send("b", "y")
    exchange(a, b)
    assert b.taken() == ["x", "y"]


def test_many_packets_that_prove_nothing_are_told_of_once_and_make_nobody_known():
    b = End("b", new_epoch())
    for number in range(10 * MANY_UNPROVED):
        b.link.hear(packet(f"x{number}", 7, 0, "b"))
    assert len(b.observer.texts) == 1
    why = f"{MANY_UNPROVED} packets were not taken: who sent them does not know the incarnation of b"
    assert why in b.observer.texts[0]
    assert b.link.peers == {}
    b.link.flush()
    assert len(b.packets) == MOST_STRANGERS


def test_a_base_beyond_what_was_sent_is_refused_and_told_of():
    _, b = met()
    b.link.hear(packet("a", 1, 1, "b", 1, 1, 0, [1, "net", ["token", "p", 1, None]]))
    b.link.hear(packet("a", 1, 1, "b", 1, 10**9, 0, [2, "net", ["token", "p", 1, None]]))
    assert b.taken() == ["p"]
    assert "it lacks 999999998 messages that a has sent" in b.observer.texts[0]
    b.link.hear(packet("a", 1, 1, "b", 1, 2, 0, [2, "net", ["token", "q", 1, None]]))
    assert b.taken() == ["p", "q"]


# Journals that are older than what the others remember.


def old_copy(of: End, journal: list[str]) -> End:
    """A process that comes back with what its journal was once."""
    of.entries = journal
    return of.reborn(of.link.name)


def test_an_old_journal_of_a_sender_is_noticed_and_no_new_message_is_lost():
    a, b = met()
    a.send("b", "1")
    exchange(a, b)
    journal = list(a.entries)
    a.send("b", "2", "3")
    exchange(a, b)
    a = old_copy(a, journal)
    a.send("b", *"45678")  # numbers that b has seen, and some that it has not
    a.link.send("b", request("r-1"))
    a.link.flush()
    assert a.packets == []  # nothing leaves before it is sure what b has
    exchange(a, b)
    assert [place_of(message) for message in b.got if place_of(message)] == list("12345678")
    assert (
        "the journal of a was an old copy, or has lost its end: b has taken 3 messages, and it knows of 1"
        in (a.observer.texts[0])
    )
    assert [reset[0] for reset in a.resets] == ["b"]
    assert [str(message) for message in a.resets[0][2]][-1] == "request r-1 to net net"
    assert b.resets[0][:2] == ("a", "a came back without its journal")
    assert len(a.observer.texts) == 1


def test_an_old_journal_of_a_receiver_is_noticed_and_the_link_goes_on():
    a, b = met()
    a.send("b", "1")
    exchange(a, b)
    journal = list(b.entries)
    a.send("b", "2", "3")
    exchange(a, b)
    b = old_copy(b, journal)
    exchange(a, b)
    a.send("b", "4")
    exchange(a, b)
    assert b.taken() == list("1234")
    assert (
        "the journal of b was an old copy, or has lost its end: it lacks 2 messages that a has sent"
        in (b.observer.texts[0])
    )
    assert a.resets[0][:2] == ("b", "b came back without its journal")


def test_a_journal_older_than_an_acquaintance_is_noticed():
    a, b = pair()
    journal = list(a.entries)
    a.send("b", "1", "2")
    exchange(a, b)
    a = old_copy(a, journal)
    a.send("b", "3")
    exchange(a, b)
    assert b.taken() == ["1", "2", "3"]
    assert "b has taken 2 messages, and it knows of 0" in a.observer.texts[0]


@settings(max_examples=60, deadline=None)
@given(st.lists(st.sampled_from(["a", "b"]), max_size=12), st.integers(0, 60), st.sampled_from("ab"))
def test_the_newest_journal_is_never_called_old(senders, kept, who):
    a, b = pair()
    dice = random.Random(kept)
    for place, sender in enumerate(senders):
        (a if sender == "a" else b).send("b" if sender == "a" else "a", str(place))
        exchange(a, b, keep=lambda text: dice.random() < 0.7)
        if dice.random() < 0.5:
            a, b = (a.reborn("a"), b) if who == "a" else (a, b.reborn("b"))
    exchange(a, b)
    assert a.observer.texts == b.observer.texts == []
    assert a.resets == b.resets == []


def test_what_only_one_process_remembers_of_another_that_lost_its_journals_end_is_noticed():
    a, b = pair()
    a.send("b", "1")
    journal = list(a.entries)
    exchange(a, b)
    b.send("a", "2")  # a takes and acknowledges it, and forgets it with the name of b
    exchange(a, b)
    a = old_copy(a, journal)
    b.send("a", "3")
    exchange(a, b)
    assert "it lacks 1 messages that b has sent" in a.observer.texts[0]
    assert [reset[0] for reset in b.resets] == ["a"]
    assert a.taken() == ["2", "3"]


def test_a_process_that_no_message_reaches_is_told_of_until_one_does():
    a, b = met()
    a.send("b", "1", "2")
    exchange(a, keep=lambda packet: False, strangers=True, rest=False, seconds=0.3)
    assert a.observer.silent == []
    exchange(a, keep=lambda packet: False, strangers=True, rest=False, seconds=0.3)
    told = "b has acknowledged nothing to a for 10 s; 2 messages wait"
    assert a.observer.silent == [told]
    exchange(a, b)
    assert a.observer.silent == [told, ""]
    assert b.taken() == ["1", "2"]


def cluster(size: int) -> dict[str, End]:
    return {name: End(name, 1) for name in "abcdef"[:size]}


@pytest.mark.parametrize("dies_again", [False, True])
def test_a_journal_without_its_end_is_noticed_once_however_many_remember_more(dies_again):
    ends = cluster(4)
    journal: list[str] = []
    for round_of in range(2):
        journal = list(ends["a"].entries)
        for other in "bcd":
            ends[other].send("a", f"{other}{round_of}")
            ends["a"].send(other, f"a{round_of}")
        exchange(*ends.values())
    ends["a"] = old_copy(ends["a"], journal)
    exchange(ends["a"], ends["b"], strangers=True, rest=False)
    if dies_again:
        ends["a"] = ends["a"].reborn("a")
    for other in "bcd":
        ends[other].send("a", f"{other}-last")
        ends["a"].send(other, f"a-to-{other}")
    exchange(*ends.values())
    assert ends["a"].taken()[6:] == ["b-last", "c-last", "d-last"]
    assert [ends[other].taken()[-1] for other in "bcd"] == ["a-to-b", "a-to-c", "a-to-d"]
    assert [ends[other].resets[-1][:2] for other in "bcd"] == [("a", "a came back without its journal")] * 3
    assert len(ends["a"].observer.texts) == (0 if dies_again else 1)


Step = st.tuples(st.sampled_from("abcdef"), st.sampled_from("abcdef"))


@settings(max_examples=60, deadline=None)
@given(st.data(), st.integers(2, 6), st.lists(Step, max_size=20), st.integers(0, 2**32))
def test_whoever_lost_the_ends_of_their_journals_all_go_on_with_all(data, size, steps, seed):
    ends, dice = cluster(size), random.Random(seed)
    for number, (sender, receiver) in enumerate(steps):
        if sender != receiver and {sender, receiver} <= ends.keys():
            ends[sender].send(receiver, str(number))
        if dice.random() < 0.5:
            exchange(*ends.values(), keep=lambda packet: dice.random() < 0.7)
    exchange(*ends.values())
    for name in data.draw(st.sets(st.sampled_from(sorted(ends)), min_size=1)):
        kept = data.draw(st.integers(0, len(ends[name].entries)))
        ends[name] = old_copy(ends[name], ends[name].entries[:kept])
    present = data.draw(st.lists(st.sampled_from(sorted(ends)), min_size=1, unique=True))  # the others are heard later
    exchange(*(ends[name] for name in present), keep=lambda packet: dice.random() < 0.7, strangers=True, rest=False)
    if data.draw(st.booleans()):
        ends["a"] = ends["a"].reborn("a")
    exchange(*ends.values(), keep=lambda packet: dice.random() < 0.7)
    for end in ends.values():
        end.got.clear()
    pairs = [(one, other) for one in ends for other in ends if one != other]
    for one, other in pairs:
        ends[one].send(other, f"{one}1", f"{one}2")
    exchange(*ends.values())
    for name, end in ends.items():  # what is sent after all know of the loss crosses once, in order, between all
        for other in ends.keys() - {name}:
            assert [place for place in end.taken() if place[0] == other] == [f"{other}1", f"{other}2"]


def test_messages_are_what_they_were_after_crossing():
    error = DataError("no spot", camera="wall", size=(1, 2))
    messages = [
        token('p\n"ü\ud800'),
        VOID,
        request("r", x=[1, None]),
        Message("net", RequestHeld("r", True)),
        Message("net", JobUpdateArrived(JobKey("p", "n", 1), False, JobUpdate.SETTLED, "m")),
    ]
    for message in messages:
        assert decode_message(json.loads(f"[{encode_message(message)}]")) == message
    reply = Message("n", ReplyArrived("r", error, {}))
    back = decode_message(json.loads(f"[{encode_message(reply)}]")).event.error
    assert (back.code, back.message, back.facts) == (
        "data", "no spot", {"camera": "wall", "size": [1, 2]},
    )  # fmt: skip


def test_of_packets_that_make_no_sense_the_first_is_told_and_then_how_many_there_were():
    _, b = pair()
    for _ in range(500):
        b.link.hear("no packet")
    b.now = 6.0
    b.link.hear("[1]")
    assert b.observer.texts == [
        "a packet was dropped: it is not JSON: Expecting value: line 1 column 1 (char 0)",
        "500 packets were dropped, the last: it makes no sense: [1]",
    ]


def test_a_payload_that_is_not_json_is_refused_before_it_is_numbered():
    a, _ = pair()
    with pytest.raises(NetError, match=r"request r to net net is not JSON data: arguments\.x is <object"):
        a.link.send("b", request("r", x=object()))
    assert a.entries == []
    assert a.link.idle()


_PLACES = st.sampled_from(["p", "q", "refused"])


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(_PLACES, st.integers(0, 9), st.integers(0, 3)), max_size=60), st.integers(0, 2**32))
def test_the_express_lane_takes_what_the_long_way_takes(steps, seed):
    dice = random.Random(seed)
    sender, quick, slow = End("a", 5), End("b", 1), End("b", 1)
    slow.link._express.read = lambda text: None
    sent: list[str] = []
    for end in (quick, slow):
        end.refuses = "refused"
    for place, fate, pause in steps:
        sender.send("b", place)
        sender.now += 0.1 * pause
        sender.link.tick()
        sent += [packet for _, packet in sender.packets]
        sender.packets.clear()
        heard = [dice.choice(sent) if fate == 0 else sent[-1]]
        if fate == 1:
            heard.append(heard[0].replace("1", str(dice.randrange(12)), 1))
        if fate == 2:
            heard.append(heard[0][: dice.randrange(len(heard[0]))])
        for end in (quick, slow):
            for text in heard:
                end.link.hear(text)
            end.now = sender.now
            end.link.tick()
        assert quick.packets == slow.packets
        for _, packet in quick.packets:
            sender.link.hear(packet)
        quick.packets.clear()
        slow.packets.clear()
    assert (quick.got, quick.entries) == (slow.got, slow.entries)
    assert quick.observer.texts == slow.observer.texts
