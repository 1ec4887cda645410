"""Measurement of the firings of given nets: one half of ``scripts/im pnt bench``."""

import random
from collections.abc import Callable, Coroutine, Sequence
from dataclasses import replace

from im_core.clock import cpu, thread_cpu
from im_core.errors import ImError
from im_pnt.execution.actions import FunctionRunner
from im_pnt.execution.events import GuardsChanged
from im_pnt.execution.executor import Executor
from im_pnt.execution.functions import ActionContext, Functions
from im_pnt.execution.jobs import Activity, Command, CommandResult
from im_pnt.model.action import AwaitAction, GoalAction, RequestAction, ServiceAction, TopicAction
from im_pnt.model.net import Net
from im_pnt_node.distributed.exchange import Exchange

_AT_ONCE = 1000
_TRIES = 100
"""How often the guards are drawn again before nets that do not move are left alone."""


def fire(nets: Sequence[Net], firings: int, seconds: float, seed: int) -> tuple[int, float]:
    """Fire nets in the executors; stuck nets begin anew.

    Actions confirm at once, guards are drawn by lot, and whenever nothing can fire the tape gets every symbol.

    Args:
        nets: The nets.
        firings: Number of firings, about.
        seconds: Largest CPU time [s].
        seed: Seed of guards and choices.

    Returns:
        Number of firings (start and end of an action are two), and their CPU time [s].
    """
    deadline = thread_cpu() + seconds
    fired, used = 0, 0.0
    for run in range(firings):
        players = _Players(nets, seed + run)
        in_vain = 0
        while fired + players.fired < firings and in_vain < _TRIES and thread_cpu() < deadline:
            began, before = cpu(), players.fired
            players.pump(min(_AT_ONCE, firings - fired - before))
            if players.fired > before:
                used += cpu() - began
                in_vain = 0
            else:
                in_vain += 1
                players.stir()
        fired += players.fired
        if fired >= firings or not players.fired or thread_cpu() >= deadline:
            break
    return fired, used


class _Players:
    """Nets in the executors, in an imagined environment."""

    def __init__(self, nets: Sequence[Net], seed: int) -> None:
        self._dice = random.Random(seed)
        actions = {name: _confirm for net in nets for name in net.functions()}
        guards = {name: self._toss for net in nets for name in net.guards()}
        functions = Functions(actions, guards)
        self._exchange = Exchange("bench", 1)
        others = dict.fromkeys((ServiceAction, GoalAction, TopicAction, AwaitAction), _perform)
        runner = FunctionRunner(functions, self._exchange, _run, others)
        self._at_work: set[tuple[str, str]] = set()
        self._commands = 0
        for net in nets:
            self._exchange.add(Executor(_bare(net), functions, runner, self._exchange, seed=seed))

    @property
    def fired(self) -> int:
        return sum(executor.sequence for executor in self._exchange.nets.values())

    def pump(self, limit: int) -> None:
        """Fire each net at most a number of times."""
        for executor in self._exchange.nets.values():
            executor.pump(limit)

    def stir(self) -> None:
        """Write every idle symbol to the tape, and draw the guards again."""
        for name, executor in self._exchange.nets.items():
            executor.post(GuardsChanged())
            for symbol in executor.net.symbols():
                key = (name, symbol)
                if key not in self._at_work:
                    self._at_work.add(key)
                    self._commands += 1
                    executor.command(Command(self._commands, symbol), self._done(key))

    def _done(self, key: tuple[str, str]) -> Callable[[CommandResult], None]:
        return lambda _: self._at_work.discard(key)

    def _toss(self, _: ActionContext) -> bool:
        return self._dice.random() < 0.5


def _confirm(_: ActionContext) -> dict[str, object]:
    """Succeed at once, as an action, and add nothing, as a builder."""
    return {}


async def _perform(_: Activity, __: ActionContext) -> dict[str, object]:
    """Succeed at once, as a service, goal or message."""
    return {}


def _bare(net: Net) -> Net:
    """Return a net without the values: imagined actions have none."""
    transitions = {}
    for name, transition in net.transitions.items():
        action = transition.action
        if isinstance(action, ServiceAction | GoalAction | TopicAction | RequestAction):
            action = replace(action, fields={})
        transitions[name] = replace(transition, action=action, result={}, store={})
    services = {name: replace(service, arguments=None) for name, service in net.services.items()}
    return replace(net, transitions=transitions, services=services, commands={})


def _run(work: Coroutine[object, object, None]) -> None:
    try:
        work.send(None)
    except StopIteration:
        return
    work.close()
    raise ImError("an imagined action waits", code="bench")
