"""Player of a timed net: an event queue; only transitions next to changed places are checked."""

import heapq
import math
from random import Random

from im_pnt.errors import NetError
from im_pnt_analysis.timed.model import TimedNet

_AT_ONE_INSTANT = 200_000
"""Firings without time passing that are taken for endless where the run ends by time alone."""

Ended = tuple["Ended | None", int, float, float]
"""Something that has taken time: what it waited for, its timer, its begin and end [s]."""


class Player:
    """A run of a timed net on a virtual clock.

    Attributes:
        time: Virtual time [s].
        tokens: Tokens of each place.
        until: Time after which nothing more happens [s].
        firings: Firings of each transition so far.
        last: What ended last; its chain of causes is the critical path. Kept only where asked for.

    Args:
        net: What to play.
        seed: The same seed gives the same run.
        causes: Keep for each event what it waited for; memory then grows with the run.
    """

    def __init__(self, net: TimedNet, seed: int, *, causes: bool = False) -> None:
        self.net = net
        self.until = math.inf
        self._dice = Random(seed)
        self._causes = causes
        compiled = net.compiled
        self._n_levels = len(net.levels)
        groups = net.levels + net.waiting
        self._group = [-1] * len(compiled.transitions)
        for number, group in enumerate(groups):
            for transition in group:
                self._group[transition] = number
        self._uniform = [len({net.weight[t] for t in group}) <= 1 for group in groups]
        self._plain = [-1] * len(compiled.transitions)
        for number, timer in enumerate(net.timers):
            if timer.active is None:
                self._plain[timer.outcomes[0][0][0]] = number
        several = {timer.outcomes[0][0][0] for timer in net.timers if timer.servers > 1}
        self._counted = [tuple(t for t, _ in arcs if t in several) for arcs in compiled.consumers]
        self._begins = [-1 if self._plain[t] >= 0 else timer for t, timer in enumerate(net.timer_of)]
        self.reset()

    def reset(self) -> None:
        """Go back to the initial marking at time 0; the dice go on."""
        compiled = self.net.compiled
        self.time = 0.0
        self.tokens = [0] * len(compiled.places)
        self.firings = [0] * len(compiled.transitions)
        self.last: Ended | None = None
        self._area = [0.0] * len(compiled.places)
        self._since = [0.0] * len(compiled.places)
        self._unmet = [len(arcs) for arcs in compiled.inputs]
        self._ready: list[list[int]] = [[] for _ in self._uniform]
        self._position = [0] * len(compiled.transitions)
        self._queue: list[tuple[float, int, int, float, Ended | None]] = []
        self._scheduled = 0
        self._stale = 0
        self._clocks: list[dict[int, None]] = [{} for _ in self.net.timers]
        self._instant = 0
        for transition, unmet in enumerate(self._unmet):
            if not unmet:
                self._enable(transition)
        self._change(tuple((place, count) for place, count in enumerate(self.net.initial) if count))
        for number, timer in enumerate(self.net.timers):
            for _ in range(0 if timer.active is None else self.tokens[timer.active]):
                self._schedule(number)

    def step(self) -> int:
        """Fire the next transition, after the time; return the transition, or -1 where there is none."""
        ready = self._ready
        for level in range(self._n_levels):
            if ready[level]:
                return self._at_once(level)
        queue = self._queue
        while queue:
            when, clock, number, since, cause = queue[0]
            timer = self.net.timers[number]
            if timer.active is None and clock not in self._clocks[number]:  # stopped: entries stay in the heap
                heapq.heappop(queue)
                self._stale -= 1
                continue
            if when > self.until or when == math.inf:
                if self.until < math.inf:
                    self.time = self.until
                return -1
            heapq.heappop(queue)
            if when > self.time:
                self.time = when
                self._instant = 0
            if self._causes:  # a chain of causes, from which the critical path is read
                self.last = (cause, number, since, when)
            if timer.active is None:
                del self._clocks[number][clock]
                transition = self._fire(timer.outcomes[0][0][0])
                self._keep_up(transition)
                return transition
            outcomes = timer.outcomes
            failed = len(outcomes) > 1 and self._dice.random() >= outcomes[0][1]
            return self._fire(self._way(outcomes[1 if failed else 0][0]))
        for level in range(self._n_levels, len(ready)):  # waiting ones, once nothing else can happen
            if ready[level]:
                return self._at_once(level)
        return -1

    def _way(self, ways: tuple[int, ...]) -> int:
        """The first of the ways in which an action may end now; one always may."""
        return next(way for way in ways if not self._unmet[way]) if len(ways) > 1 else ways[0]

    def token_time(self) -> list[float]:
        """Return for each place the tokens, integrated over the time so far [s]."""
        return [
            area + count * (self.time - since)
            for area, count, since in zip(self._area, self.tokens, self._since, strict=True)
        ]

    def _at_once(self, level: int) -> int:
        self._instant += 1
        if self._instant > _AT_ONE_INSTANT and self.until < math.inf:
            raise NetError(f"{_AT_ONE_INSTANT} firings at time {self.time:g} s: no time passes any more")
        return self._fire(self._choose(level, self._ready[level]))

    def _choose(self, level: int, choices: list[int]) -> int:
        if len(choices) == 1:
            return choices[0]
        if self._uniform[level]:
            return choices[int(self._dice.random() * len(choices))]
        weight = self.net.weight
        left = self._dice.random() * sum([weight[transition] for transition in choices])
        for transition in choices:
            left -= weight[transition]
            if left < 0.0:
                return transition
        return choices[-1]

    def _fire(self, transition: int) -> int:
        self.firings[transition] += 1
        self._change(self.net.compiled.change[transition])
        begun = self._begins[transition]
        if begun >= 0:
            self._schedule(begun)
        return transition

    def _change(self, changes: tuple[tuple[int, int], ...]) -> None:
        compiled, tokens, unmet, now = self.net.compiled, self.tokens, self._unmet, self.time
        for place, change in changes:
            before = tokens[place]
            after = tokens[place] = before + change
            self._area[place] += before * (now - self._since[place])
            self._since[place] = now
            low, high, step = (before, after, -1) if change > 0 else (after, before, 1)
            for transition, weight in compiled.consumers[place]:
                if low < weight <= high:
                    unmet[transition] += step
                    if not unmet[transition]:
                        self._enable(transition)
                    elif step > 0 and unmet[transition] == 1:
                        self._disable(transition)
            for transition, weight in compiled.inhibited[place]:
                if low < weight <= high:
                    unmet[transition] -= step
                    if not unmet[transition]:
                        self._enable(transition)
                    elif step < 0 and unmet[transition] == 1:
                        self._disable(transition)
            for transition in self._counted[place]:
                self._keep_up(transition)

    def _enable(self, transition: int) -> None:
        group = self._group[transition]
        if group >= 0:
            ready = self._ready[group]
            self._position[transition] = len(ready)
            ready.append(transition)
        elif self._plain[transition] >= 0:
            self._keep_up(transition)

    def _disable(self, transition: int) -> None:
        group = self._group[transition]
        if group >= 0:
            ready = self._ready[group]
            position = self._position[transition]
            last = ready.pop()
            if last != transition:
                ready[position] = last
                self._position[last] = position
        elif self._plain[transition] >= 0:
            self._keep_up(transition)

    def _keep_up(self, transition: int) -> None:
        """Run as many clocks of a transition without action as it has servers with tokens; the youngest stop first."""
        number = self._plain[transition]
        clocks, wanted = self._clocks[number], 0 if self._unmet[transition] else 1
        if wanted and (servers := self.net.timers[number].servers) > 1:
            wanted = min(servers, self.net.compiled.degree(self.tokens, transition))
        while len(clocks) < wanted:
            clocks[self._schedule(number)] = None
        while len(clocks) > wanted:
            clocks.popitem()
            self._stale += 1
            if self._stale > 64 and self._stale > len(self._queue) // 2:
                self._forget_stale()

    def _schedule(self, number: int) -> int:
        try:
            when = self.time + self.net.timers[number].delay.sample(self._dice)
        except (OverflowError, ZeroDivisionError):
            when = math.inf
        self._scheduled += 1
        heapq.heappush(self._queue, (when, self._scheduled, number, self.time, self.last))
        return self._scheduled

    def _forget_stale(self) -> None:
        timers, clocks = self.net.timers, self._clocks
        self._queue = [e for e in self._queue if timers[e[2]].active is not None or e[1] in clocks[e[2]]]
        heapq.heapify(self._queue)
        self._stale = 0
