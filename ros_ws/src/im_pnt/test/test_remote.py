"""Exactly once, whatever the network does; and the requests of three processes over such a network."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_core.errors import DataError
from im_pnt.netfile import parse_net
from im_pnt.remote import Ack, Envelope, Kind, Message, Receiver, Sender
from im_pnt.testing import Process, hold


class Network:
    """Loses, doubles and reorders what it carries, for nodes that are given later."""

    def __init__(self, seed: int, loss: float) -> None:
        self.dice = random.Random(seed)
        self.loss = loss
        self.now = 0.0
        self.flying: list[tuple[float, Envelope | Ack]] = []
        self.nodes: dict[str, Node] = {}

    def carry(self, thing: Envelope | Ack) -> None:
        for _ in range(self.dice.choice((1, 1, 2))):
            if self.dice.random() >= self.loss:
                self.flying.append((self.now + self.dice.uniform(0.0, 1.0), thing))

    def run(self, seconds: float) -> None:
        end = self.now + seconds
        while self.now < end:
            self.now += 0.05
            for node in self.nodes.values():
                for envelope in node.sender.due(self.now):
                    self.carry(envelope)
            due = [item for item in self.flying if item[0] <= self.now]
            self.flying = [item for item in self.flying if item[0] > self.now]
            for _, thing in sorted(due, key=lambda item: item[0]):
                self.arrive(thing)
            for node in self.nodes.values():
                node.pump()

    def arrive(self, thing: Envelope | Ack) -> None:
        if isinstance(thing, Envelope):
            self.carry(self.nodes[thing.receiver].receiver.receive(thing))
        else:
            self.nodes[thing.sender].acknowledged(thing)


class Node:
    """A process on the network; also its transport."""

    def __init__(self, network: Network, name: str, texts: list[str], actions: dict) -> None:
        self.network = network
        self.sender = Sender(name, 1)
        self.receiver = Receiver(name, 1, lambda sender, message: self.process.exchange.receive(sender, message))
        nets = [parse_net(text) for text in texts]
        self.process = Process(nets, actions, name=name, transport=self)
        self.pump = self.process.pump
        network.nodes[name] = self

    def node_of(self, net: str) -> str:
        return net

    def send(self, node: str, message: Message) -> None:
        self.network.carry(self.sender.send(node, message, self.network.now))

    def forget(self, request_id: str) -> None:
        self.sender.forget(request_id)

    def acknowledged(self, ack: Ack) -> None:
        returned = self.sender.acknowledged(ack)
        if returned is not None:
            self.process.exchange.refused(returned, ack.refusal)


RING = """
net: {0}
places: {{p: {{tokens: {2}, remote: true}}}}
transitions: {{t: {{in: p, out: {1}.p, action: f, on_failure: p}}}}
"""


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.0, 0.6))
def test_tokens_circle_and_none_is_lost_or_doubled(seed, loss):
    network = Network(seed, loss)
    for name, after, tokens in (("a", "b", 2), ("b", "c", 0), ("c", "a", 1)):
        Node(network, name, [RING.format(name, after, tokens)], {"f": hold})
    processes = [node.process for node in network.nodes.values()]
    for _ in range(6):
        for process in processes:
            process.pump()
            while process.held:
                process.end("t")
        network.run(network.dice.uniform(0.0, 2.0))
    network.loss = 0.0
    network.run(10.0)
    tokens = sum(sum(process.marking(name).values()) for name, process in zip("abc", processes, strict=True))
    assert tokens == 3
    assert all(node.sender.unacknowledged() == 0 for node in network.nodes.values())


FRONT = """
net: front
places: {idle: 1, asked: , good: , bad: }
transitions:
  begin: {in: idle, out: asked, symbol: go}
  ask: {in: asked, out: good, request: middle.serve, on_failure: bad}
  finish: {in: good, out: idle, emit: go_done}
  give_up: {in: bad, out: idle, emit: go_failed}
"""
MIDDLE = """
net: middle
places: {wanted: , good: , bad: }
services: {serve: {entry: wanted, done: good, failed: bad}}
transitions: {pass_on: {in: wanted, out: good, request: back.serve, on_failure: bad}}
"""
BACK = """
net: back
places: {wanted: , good: , bad: }
services: {serve: {entry: wanted, done: good, failed: bad}}
transitions: {work: {in: wanted, out: good, action: work, on_failure: bad}}
"""


@pytest.mark.parametrize("seed", range(6))
def test_requests_and_failures_cross_three_processes_over_a_bad_network(seed):
    network = Network(seed, 0.4)
    asked = []

    def work(ctx):
        asked.append(ctx.command.id)
        if ctx.command.id % 2 == 0:
            raise DataError("even ones fail", number=ctx.command.id)

    front = Node(network, "front", [FRONT], {})
    Node(network, "middle", [MIDDLE], {})
    Node(network, "back", [BACK], {"work": work})
    for _ in range(4):
        front.process.command("front", "go")
    network.run(120.0)
    assert asked == [1, 2, 3, 4]
    assert [result.success for result in front.process.results] == [True, False, True, False]
    assert front.process.results[1].error.facts == {"number": 2}


def test_the_death_of_a_coordinator_fails_its_requests_and_that_of_a_caller_cancels_its_work():
    network = Network(0, 0.0)
    front = Node(network, "front", [FRONT], {})
    Node(network, "middle", [MIDDLE], {})
    back = Node(network, "back", [BACK], {"work": hold})
    front.process.command("front", "go")
    network.run(5.0)
    context = back.process.held[0][2]
    assert front.process.exchange.partners() == {"middle"}
    assert back.process.exchange.partners() == {"middle"}
    back.process.exchange.node_lost("middle", "middle is missing")
    back.pump()
    assert context.cancelled
    front.process.exchange.node_lost("middle", "middle is missing (last heard 6.1 s ago)")
    front.pump()
    assert str(front.process.results[0].error) == "middle is missing (last heard 6.1 s ago)"
    assert front.process.marking("front") == {"idle": 1}


def test_messages_of_an_earlier_life_and_for_unknown_nets_are_refused():
    taken: list[Message] = []

    def accept(sender: str, message: Message) -> str:
        taken.append(message)
        return "" if message.net == "known" else f"there is no net {message.net}"

    receiver = Receiver("r", 7, accept)
    old, new = Sender("s", 1), Sender("s", 2)
    stale = old.send("r", Message(Kind.TOKEN, "known", "p"), 0.0)
    fresh = new.send("r", Message(Kind.TOKEN, "known", "p"), 0.0)
    wrong = new.send("r", Message(Kind.TOKEN, "unknown", "p"), 0.0)
    assert receiver.receive(fresh).refusal == ""
    assert receiver.receive(stale).refusal == "sent by an earlier incarnation of s"
    refusals = {receiver.receive(wrong).refusal for _ in range(3)}
    assert refusals == {"there is no net unknown"}
    assert len(taken) == 2
    assert new.acknowledged(receiver.receive(wrong)) == wrong.message
    assert new.acknowledged(receiver.receive(wrong)) is None
