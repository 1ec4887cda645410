"""Many random interruptions in one seeded run: the arm never leaps."""

import numpy as np
import pytest

from im_mcs.state import State

DT = 0.0045
JERK_FACTOR = 2.0
LAWS = ["im_mcs.control.computed_torque:ComputedTorque", "im_mcs.control.pid_gravity:PidGravity"]
OWNER = {"left": "ann", "right": "bob"}
ALL = {"names": list(OWNER.values())}
KINDS = [
    "estop", "pause", "resume", "cancel", "silence", "repartition", "set_controller", "protective_stop", "set_speed",
    "replace", "append", "stream", "torque",
]  # fmt: skip


class Run:
    """A machine that is interrupted, with every tick judged."""

    def __init__(self, bench, random):
        self.bench, self.mcs, self.random = bench, bench.mcs, random
        self.limits = self.mcs.limits
        self.last = None
        self.renewed = 0
        self.silent = False
        self.goals = []
        self.driven = []

    def ticks(self, count, request=None, **arguments):
        """Let time pass; the first tick hears a request, whose number is returned."""
        number = None
        for k in range(count):
            messages = []
            if k == 0 and request is not None:
                self.bench._number += 1
                number = self.bench._number
                messages.append({"id": number, "request": request, "arguments": arguments})
            if not self.silent and self.mcs.manager.reservations.groups and self.mcs.measured.tick % 20 == 0:
                messages += [{"id": 0, "request": "renew", "arguments": {"owner": o}} for o in OWNER.values()]
            self.mcs.tick(messages)
            self.judge()
        return number

    def judge(self):
        mcs, limits = self.mcs, self.limits
        q, measured = mcs.setpoint.copy(), mcs.measured.q.copy()
        driven = [name for name in mcs.groups if mcs.loop.torque_streams.torque(name) is not None]
        engaged = np.zeros(18, dtype=bool)
        judged = np.zeros(18, dtype=bool)
        for name, group in mcs.groups.items():
            engaged[group.index] = group.engaged
            judged[group.index] = group.engaged and name not in driven and name not in self.driven
        if self.last is not None:
            last, last_q, was = self.last
            assert (np.abs(measured - last_q) <= 1.3 * limits.ceiling.velocity * DT).all()
            new = engaged & ~was
            assert (q[0, new] == measured[new]).all()  # the first setpoint is the measured place
            i = engaged & was & judged
            assert (np.abs(q[2, i]) <= limits.ceiling.acceleration[i] * 1.001).all()
            assert (np.abs(q[1, i]) <= limits.ceiling.velocity[i] * 1.001).all()
            jerk = limits.ceiling.jerk[i]
            assert (np.abs(q[2, i] - last[2, i]) <= JERK_FACTOR * jerk * DT * 1.001).all()
            expected = last[0, i] + DT * last[1, i] + DT**2 / 2.0 * last[2, i]
            assert (np.abs(q[0, i] - expected) <= JERK_FACTOR * jerk * DT**3).all()
        self.driven = driven
        self.last = q, measured, engaged

    def ask(self, request, **arguments):
        number = self.ticks(1, request, **arguments)
        for _ in range(3000):
            reply = self.bench.reply(number)
            if reply is not None:
                return reply
            self.ticks(1)
        raise AssertionError(f"{request} was not answered")

    def to_motion(self):
        """By the ordinary ways, from wherever it is."""
        self.silent = False
        for _ in range(12):
            state = self.mcs.manager.state
            if state is State.MOTION:
                return
            if state is State.ESTOPPED:
                self.ask("reset")
            elif state is State.COLD or len(self.mcs.manager.reservations.groups) < 2:
                for name in ("left", "right"):
                    self.ask("reserve", group=name, owner=OWNER[name], lease_s=0.4)
            else:
                self.ask("power_on" if state is State.RESERVED else "enable_motion", sender=ALL)
        raise AssertionError(f"stuck in {self.mcs.manager.state}")

    def path(self, group):
        index = self.mcs.groups[group].index
        home = self.mcs.model.cell.home[index]
        points = home + self.random.uniform(-0.25, 0.25, (self.random.integers(1, 4), len(index)))
        points = np.clip(points, self.limits.lower[index], self.limits.upper[index])
        return {"kind": "joint", "points": points.tolist(), "blend": 0.0}

    def move(self, group, policy="replace"):
        self.goals.append(self.ticks(1, "move", group=group, path=self.path(group), policy=policy, sender=ALL))

    def interrupt(self, kind):
        group = str(self.random.choice(["left", "right"]))
        match kind:
            case "estop" | "protective_stop":
                self.ticks(1, kind, reason="at random")
            case "pause":
                self.ticks(1, kind, group=str(self.random.choice(["", group])))
            case "resume":
                self.ticks(1, kind, group=str(self.random.choice(["", group])), sender=ALL)
            case "cancel":
                self.ticks(1, "cancel", goal=self.goals[-1])
            case "silence":
                self.silent = True
                self.ticks(130)
                assert self.mcs.manager.reservations.of("left").lapsed
            case "repartition":
                self.ask_until_rest("disable_motion")
                self.ask("power_off", sender=ALL)
                for name in self.mcs.manager.reservations.groups:
                    self.ask("release", group=name, sender=ALL)
                preset = "3x6" if self.mcs.config.preset == "2x9" else "2x9"
                assert self.ask("repartition", preset=preset)["success"]
            case "set_controller":
                self.ticks(1, kind, group=group, controller=str(self.random.choice(LAWS)), sender=ALL)
            case "set_speed":
                self.ticks(1, kind, group=group, scale=float(self.random.uniform(0.2, 1.0)), sender=ALL)
            case "replace" | "append":
                self.move(group, kind)
            case "stream":
                q = self.mcs.setpoint[0, self.mcs.groups[group].index] + self.random.uniform(-0.01, 0.01)
                given = {"group": group, "kind": "setpoint", "positions": q.tolist(), "owner": OWNER[group]}
                self.ticks(1, kind, **given, lease_s=0.05)
            case "torque":
                index = self.mcs.groups[group].index
                tau = self.mcs.model.gravity(self.mcs.measured.q)[index].tolist()
                given = {"group": group, "kind": "torque", "torques": tau, "owner": OWNER[group]}
                self.ticks(1, "stream", **given, lease_s=0.05)

    def leave_and_join(self, group):
        """One group is braked, switched off, released and taken again, whatever the other does meanwhile."""
        given = {"group": group, "sender": ALL}
        for goal in self.mcs.groups[group].goals[:1]:
            self.ticks(1, "cancel", goal=goal.id)
        while self.mcs.moving((group,)) is not None:
            self.ticks(1)
        for request in ("disable_motion", "power_off", "release"):
            assert self.ask(request, **given)["success"]
        self.ticks(int(self.random.integers(0, 20)))
        assert self.ask("reserve", group=group, owner=OWNER[group], lease_s=0.4)["success"]
        for request in ("power_on", "enable_motion"):
            assert self.ask(request, **given)["success"]

    def ask_until_rest(self, request):
        for goal in self.goals:
            if self.bench.reply(goal) is None:
                self.ticks(1, "cancel", goal=goal)
        while self.mcs.moving(("left", "right")) is not None:
            self.ticks(1)
        assert self.ask(request, sender=ALL)["success"]


def test_seventy_interruptions(bench):
    random = np.random.default_rng(11)
    run = Run(bench, random)
    for kind in random.permutation(5 * KINDS):
        run.to_motion()
        run.ticks(1, "renew", owner="ann")
        for group in ("left", "right"):
            if random.random() < 0.7:
                run.move(group, str(random.choice(["replace", "refuse", "append"])))
        run.ticks(int(random.integers(5, 60)))
        run.interrupt(str(kind))
        run.ticks(int(random.integers(1, 30)))
        if random.random() < 0.5:
            run.ticks(1, "resume", sender=ALL)
    succeeded = [e for e in bench.events if e["event"] == "reply" and e["id"] in run.goals and e["success"]]
    assert succeeded
    run.to_motion()
    run.ask_until_rest("disable_motion")
    assert all(bench.reply(goal) is not None for goal in run.goals)
    for event in bench.events:
        if event["event"] == "reply" and not event["success"]:
            assert event["error"]["code"] in ("state", "cancelled", "replaced", "lease", "protective_stop", "collision")
    assert bench.mcs.saturations.counts[:4].sum() == 0


def test_groups_that_leave_and_join_while_others_move(bench):
    random = np.random.default_rng(11)
    run = Run(bench, random)
    run.to_motion()
    moving = 0
    for _ in range(5):
        for group in ("left", "right"):
            run.move(group, "append")
        run.ticks(int(random.integers(5, 60)))
        leaves, stays = random.permutation(["left", "right"])
        run.leave_and_join(str(leaves))
        moving += bench.mcs.moving((str(stays),)) is not None
    assert moving > 1
    for goal in run.goals:
        error = (bench.reply(goal) or {}).get("error")
        assert error is None or error["code"] in ("cancelled", "collision"), error
    assert bench.mcs.saturations.counts[:4].sum() == 0


@pytest.mark.parametrize("waits", [True, False])
def test_what_replaces_a_motion_that_stands_still_is_planned_anew_when_that_goes_on(bench, waits):
    """While a long path is prepared, a motion that waited begins, or one that was paused is resumed."""
    run = Run(bench, np.random.default_rng(5))
    run.to_motion()
    index = bench.mcs.groups["left"].index
    home = bench.mcs.model.cell.home[index]
    near, far = {"kind": "joint", "points": [(home + 0.05).tolist()]}, [home + 0.1, home] * 40
    long = {"kind": "joint", "points": [point.tolist() for point in far], "blend": 0.0}
    given = {"group": "left", "sender": ALL}
    first = run.ticks(1, "move", path=near, **given)
    if waits:
        back = run.ticks(1, "move", path={"kind": "joint", "points": [home.tolist()]}, policy="append", **given)
        while not bench.mcs.groups["left"].planner.finished:
            run.ticks(1)
    else:
        run.ticks(60)
        run.ticks(1, "pause", group="left")
        while not bench.mcs.groups["left"].still:
            run.ticks(1)
    last = run.ticks(1, "move", path=long, policy="replace", **given)
    run.ticks(1, "resume", **given)
    while bench.reply(first) is None or (waits and bench.reply(back) is None):
        run.ticks(1)
    run.ticks(50)
    assert bench.mcs.saturations.counts[:4].sum() == 0
    assert bench.reply(last) is None  # it is followed
