"""Exactly once, whatever the network does; and the requests of three processes over such a network."""

import math
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_core.errors import DataError
from im_pnt.netfile import parse_net
from im_pnt_node.distributed.link import Link
from support.process import Process, hold


class Network:
    """Loses, doubles and reorders what it carries, for nodes that are given later."""

    def __init__(self, seed: int, loss: float) -> None:
        self.dice = random.Random(seed)
        self.loss = loss
        self.now = 0.0
        self.flying: list[tuple[float, str, str]] = []
        self.nodes: dict[str, Node] = {}

    def carry(self, node: str, packet: str) -> None:
        for _ in range(self.dice.choice((1, 1, 2))):
            if self.dice.random() >= self.loss:
                self.flying.append((self.now + self.dice.uniform(0.0, 1.0), node, packet))

    def run(self, seconds: float) -> None:
        end = self.now + seconds
        while self.now < end:
            self.now += 0.05
            due = [item for item in self.flying if item[0] <= self.now]
            self.flying = [item for item in self.flying if item[0] > self.now]
            for _, node, packet in sorted(due, key=lambda item: item[0]):
                self.nodes[node].link.hear(packet)
            for node in self.nodes.values():
                node.pump()
                node.link.tick()


class Node:
    """A process on the network; also its transport."""

    def __init__(self, network: Network, name: str, texts: list[str], actions: dict) -> None:
        self.link = Link(
            name,
            1,
            lambda sender, message: self.process.exchange.receive(sender, message),
            lambda message, why: self.process.exchange.refused(message, why),
            lambda node, why, in_flight: self.process.exchange.node_reset(node, why, in_flight),
            lambda node: self.process.exchange.node_returned(node),
            network.carry,
            clock=lambda: network.now,
        )
        self.send, self.forget, self.keeps_journal = self.link.send, self.link.forget, self.link.keeps_journal
        nets = [parse_net(text) for text in texts]
        self.process = Process(nets, actions, name=name, transport=self)
        self.pump = self.process.pump
        network.nodes[name] = self

    def node_of(self, net: str) -> str:
        return net


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
    assert all(node.link.idle() for node in network.nodes.values())


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


def test_a_result_that_json_cannot_say_fails_the_request_with_a_sentence():
    network = Network(0, 0.0)
    front = Node(network, "front", [FRONT], {})
    Node(network, "middle", [MIDDLE], {})
    Node(network, "back", [BACK], {"work": lambda ctx: ctx.result.update(score=math.nan)})
    front.process.command("front", "go")
    network.run(5.0)
    assert "is not JSON data: results.score is nan" in front.process.results[0].error.message
    assert all(node.link.idle() for node in network.nodes.values())


def test_a_token_whose_job_json_cannot_say_is_kept_and_said():
    """Without a journal nobody has looked at the arguments of the command."""
    network = Network(0, 0.0)
    sends = "net: sends\nplaces: {a: 1, b: }\ntransitions: {t: {in: a, out: [b, gets.p], symbol: go}}"
    node = Node(network, "sends", [sends], {})
    node.process.command("sends", "go", width=math.nan)
    assert {str(place): count for place, count in node.process.exchange.undeliverable.items()} == {"gets.p": 1}
    assert "is not JSON data: arguments.width is nan" in node.process.recorder.troubles[0]


def test_a_number_that_is_none_among_the_facts_of_a_failure_crosses_as_text():
    network = Network(0, 0.0)

    def work(ctx):
        raise DataError("no distance", distance=math.inf)

    front = Node(network, "front", [FRONT], {})
    Node(network, "middle", [MIDDLE], {})
    Node(network, "back", [BACK], {"work": work})
    front.process.command("front", "go")
    network.run(5.0)
    error = front.process.results[0].error
    assert (error.message, error.facts) == ("no distance", {"distance": "Infinity"})


def test_who_asks_a_net_that_its_own_process_does_not_run_is_told_so_at_once():
    """Nobody has announced the net, and the process has its name: it would wait for itself."""
    network = Network(0, 0.0)
    middle = Node(network, "middle", [FRONT], {})
    middle.process.command("front", "go")
    network.run(5.0)
    assert "there is no net middle" in middle.process.results[0].error.message
    gives = Node(network, "gets", ["net: gives\nplaces: {a: 1}\ntransitions: {t: {in: a, out: gets.p}}"], {})
    network.run(5.0)
    assert {str(place): count for place, count in gives.process.exchange.undeliverable.items()} == {"gets.p": 1}
    assert all(node.link.idle() for node in network.nodes.values())
