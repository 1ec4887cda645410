"""Throw values at every interface of the machine of this ROS domain; prints what was sent and what did not answer.

Exit codes: 0 everything answered and every process lives, 1 not so (said what).
"""

import argparse
import json
import sys
import threading
from dataclasses import dataclass, replace

import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from bench.fuzz.attack import Attack
from bench.fuzz.targets import Target, targets
from bench.fuzz.values import Values
from bench.part import positive
from bench.usage import memory_mib
from im_core import clock
from im_core.ros import qos
from im_core.ros.run import spin_in_thread
from im_msgs.msg import TaskRegistry

#: How long the machine is given to become quiet before its memory is read again [s].
QUIET_S = 5.0


class Census(Node):
    """Knows the processes of the machine, and what they hold."""

    def __init__(self) -> None:
        super().__init__("fuzz")
        self._tasks: dict[str, tuple[int, int]] = {}
        self.create_subscription(TaskRegistry, "/bootstrap/tasks", self._learn, qos.LATCHED)

    def _learn(self, registry: TaskRegistry) -> None:
        self._tasks = {task.name: (task.pid, task.restarts) for task in registry.tasks}

    def restarts(self) -> dict[str, int]:
        """How often each task was started again."""
        return {name: restarts for name, (_, restarts) in self._tasks.items()}

    def memory(self) -> dict[str, float]:
        """Memory of each task [MiB]."""
        return {name: memory_mib([pid]) for name, (pid, _) in self._tasks.items()}


def slow_subscribers(count: int, found: list[Target]) -> list[Node]:
    """Nodes that subscribe and never take anything; what is sent reliably must be acknowledged by them, too."""
    nodes = []
    topics = [target for target in found if target.kind == "topic"]
    for number in range(count):
        node = Node(f"fuzz_slow_{number}")
        target = topics[number % len(topics)]
        offered = [each.qos_profile.reliability for each in node.get_publishers_info_by_topic(target.name)]
        reliable = all(each is ReliabilityPolicy.RELIABLE for each in offered)
        kind = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
        profile = QoSProfile(depth=qos.STATUS.depth, reliability=kind)
        node.create_subscription(target.type, target.name, lambda _: None, profile)
        nodes.append(node)
    return nodes


@dataclass(frozen=True)
class Plan:
    """What is thrown.

    Attributes:
        clients: Nodes that throw, which share the interfaces.
        slow: Nodes that subscribe and never take anything.
        rounds: How often something is thrown at each interface, where ``seconds`` is 0.
        rate: Throws a second of all clients together; 0: as many as go.
        seconds: How long [s]; 0: ``rounds`` rounds.
        seed: Of what is drawn.
        large: Share of texts and lists of bytes that have two million elements.
    """

    clients: int = 1
    slow: int = 0
    rounds: int = 5
    rate: float = 0.0
    seconds: float = 0.0
    seed: int = 0
    large: float = 0.002


#: What the machine must bear for long: many clients that throw, and many that do not listen.
LONG = Plan(clients=50, slow=100, rate=200.0, seconds=60.0)


def attack(plan: Plan) -> dict[str, object]:
    """Throw values at the machine of this ROS domain; ROS is initialised.

    Returns:
        What was found, as JSON data: ``interfaces``, ``sent``, ``unanswered``, ``restarted`` (tasks that were started
        again meanwhile) and ``grown`` (memory of each task afterwards less that before [MiB]).
    """
    census = Census()
    nodes = [Node(f"fuzz_{number}") for number in range(plan.clients)]
    with spin_in_thread(census, *nodes):
        found = _settled(nodes[0], census)
        attacks = [Attack(node, Values(plan.seed + number, plan.large)) for number, node in enumerate(nodes)]
        for number, each in enumerate(attacks):
            each.open(found[number :: plan.clients])  # thousands of ends would be no attack but a flood of discovery
        idle = slow_subscribers(plan.slow, found)
        before, restarts = census.memory(), census.restarts()
        pause_s = plan.clients / plan.rate if plan.rate else 0.0
        until = clock.monotonic() + plan.seconds

        def run(one: Attack, mine: list[Target]) -> None:
            done = 0
            while clock.monotonic() < until if plan.seconds else done < plan.rounds:
                for target in mine:
                    one.throw(target)
                    clock.sleep(pause_s)
                done += 1
            one.finish()

        threads = [
            threading.Thread(target=run, args=[each, found[number :: plan.clients]], daemon=True)
            for number, each in enumerate(attacks)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        clock.sleep(QUIET_S)
        after, now = census.memory(), census.restarts()
        for node in idle:
            node.destroy_node()
    return {
        "interfaces": {kind: sum(target.kind == kind for target in found) for kind in ("topic", "service", "action")},
        "sent": {kind: sum(each.sent[kind] for each in attacks) for kind in ("topic", "service", "action")},
        "unanswered": sorted({name for each in attacks for name in each.unanswered}),
        "restarted": sorted(name for name in restarts if now.get(name) != restarts[name]),
        "grown": {name: round(after[name] - before[name], 1) for name in sorted(before) if name in after},
    }


def _settled(node: Node, census: Census) -> list[Target]:
    """The interfaces of the machine, when a node has discovered all: when it finds no more for two seconds."""
    found: list[Target] = []
    looks = 0
    while looks < 2:
        clock.sleep(1.0)
        before, found = found, targets(node, {"bootstrap", *census.restarts()})
        looks = looks + 1 if found and found == before else 0
    return found


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="python -m bench.fuzz", description=__doc__)
    parser.add_argument("--rounds", type=positive(int), default=5, help="throws of each client at each interface")
    parser.add_argument("--seconds", type=float, default=0.0, help="go on for so long instead, e.g. 60")
    parser.add_argument("--rate", type=float, default=0.0, help="throws a second in all, e.g. 200 (default: what goes)")
    parser.add_argument("--clients", type=positive(int), default=1, help="nodes that throw, e.g. 50")
    parser.add_argument("--slow", type=int, default=0, help="nodes that subscribe and never take anything, e.g. 100")
    parser.add_argument("--large", type=float, default=0.002, help="share of texts that have two million characters")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--long",
        action="store_true",
        help=f"{LONG.rate:g} throws a second for {LONG.seconds:g} s, {LONG.clients} clients, {LONG.slow} that do not "
        "listen; only --seed and --large are heeded",
    )
    told = vars(parser.parse_args())
    plan = replace(LONG, seed=told["seed"], large=told["large"]) if told.pop("long") else Plan(**told)
    rclpy.init(args=[])
    found = attack(plan)
    rclpy.try_shutdown()
    print(json.dumps(found, indent=1))
    return 1 if found["unanswered"] or found["restarted"] else 0


if __name__ == "__main__":
    sys.exit(main())
