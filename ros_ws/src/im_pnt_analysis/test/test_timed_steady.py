"""Steady states against published results, closed formulas, and an independent dense solution of random nets."""

import math

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_pnt.errors import NetError
from im_pnt.model.action import FunctionAction, RequestAction
from im_pnt.model.compiled import compile_net
from im_pnt.model.delay import Delay, exponential
from im_pnt.model.net import LARGEST, Net, Place, Service, Transition
from im_pnt.netfile import load_net, parse_net
from im_pnt_analysis.simulation.simulate import summarise
from im_pnt_analysis.timed.steady import steady_state
from support.fixtures import NETS


def close(value):
    """To twelve digits: elimination without subtraction loses none."""
    return pytest.approx(value, rel=1e-12, abs=1e-15)


def t(name, inputs, outputs, delay=None, **more):
    """A transition from place names, a name repeated for each token."""
    arcs = [{p: names.split().count(p) for p in names.split()} for names in (inputs, outputs)]
    return Transition(name, arcs[0], arcs[1], delay=delay, **more)


def net(name, marking, *transitions, **more):
    places = {place: Place(place) for one in transitions for place in (*one.inputs, *one.outputs, *one.on_failure)}
    places |= {place: Place(place, tokens) for place, tokens in marking.items()}
    return Net(name, places, {one.name: one for one in transitions}, **more)


MOLLOY = load_net(NETS / "molloy.yaml")


def test_molloy_1982_comes_out():
    state = steady_state([MOLLOY])
    shares = {tuple(sorted(marking)): share for marking, share in state.probability}
    expected = {
        ("p1",): 5 / 43,
        ("p2", "p3"): 8 / 43,
        ("p3", "p4"): 2 / 43,
        ("p2", "p5"): 23 / 43,
        ("p4", "p5"): 5 / 43,
    }
    assert shares == close(expected)
    assert state.throughput["t1"] == close(10 / 43)
    assert state.throughput["t2"] == close(31 / 43)
    assert state.throughput["t4"] == close(21 / 43)


def test_queue_with_five_places():
    state = steady_state(
        [
            net(
                "mm15",
                {"free": 5},
                t("arrive", "free", "queue", exponential(2)),
                t("serve", "queue", "free", exponential(3)),
            )
        ]
    )
    assert state.throughput["serve"] == close(1266 / 665)
    assert state.marked["queue"] == close(422 / 665)
    assert state.tokens["queue"][5] == close(32 / 665)
    assert state.busy["serve"] == close(state.marked["queue"])


def test_server_shared_by_two_callers():
    parts = [
        part
        for c in "ab"
        for part in (
            t(f"think_{c}", f"idle_{c}", f"I_{c}", exponential(1)),
            t(f"start_{c}", f"I_{c} SI", f"active_{c}"),
            t(f"serve_{c}", f"active_{c}", f"O_{c} SI", exponential(3)),
            t(f"return_{c}", f"O_{c}", f"idle_{c}"),
        )
    ]
    state = steady_state([net("shared", {"idle_a": 1, "idle_b": 1, "SI": 1}, *parts)])
    assert (state.tangible, state.vanishing) == (5, 8)
    assert [state.throughput[f"serve_{c}"] for c in "ab"] == close([12 / 17] * 2)


def caller(name, think):
    ask = t("ask", "ready", "idle", action=RequestAction("server", "work"), on_failure={"bad": 1})
    again = t("again", "bad", "idle", exponential(1000.0))
    return net(name, {"idle": 1}, t("think", "idle", "ready", think), ask, again)


def server(success=1.0, delay=None):
    work = t(
        "work",
        "wanted",
        "done",
        delay or exponential(3),
        action=FunctionAction("f"),
        on_failure={"no": 1},
        success=success,
    )
    return net("server", {}, work, services={"work": Service("work", "wanted", "done", "no")})


def test_coordination_structure_with_two_callers():
    state = steady_state([caller("a", exponential(1)), caller("b", exponential(1)), server()])
    assert state.throughput["a.ask.end"] == close(12 / 17)
    assert state.throughput["b.think"] == close(12 / 17)
    assert state.throughput["a.ask.failed"] == 0


def test_failure_of_a_service_is_the_failure_of_its_caller():
    state = steady_state([caller("a", exponential(1)), server(success=0.25)])
    assert state.throughput["a.ask.failed"] == close(3 * state.throughput["a.ask.end"])
    assert state.throughput["a.ask.failed"] == close(state.throughput["server.work.failed"])


def test_delay_of_an_action_starts_for_each_token():
    """Two actions at once, each with its own time: M/M/2/2 with two customers."""
    work = t("work", "ready", "idle", exponential(1), action=FunctionAction("f"), on_failure={"idle": 1})
    state = steady_state([net("two", {"idle": 2}, t("think", "idle", "ready", exponential(1)), work)])
    # Thinking is one server, working is one for each: p0, p1, p2 busy = 2 : 2 : 1.
    assert state.tokens["work.active"] == close({0: 2 / 5, 1: 2 / 5, 2: 1 / 5})


def test_loop_of_immediate_transitions_is_left_by_its_weights():
    """Heads or tails until heads: 1 of 3 tries in the loop ends it."""
    coin = net(
        "coin",
        {"a": 1},
        t("wait", "a", "b", exponential(4)),
        t("again", "b", "c", weight=2.0),
        t("back", "c", "b"),
        t("end", "b", "a", weight=1.0),
    )
    state = steady_state([coin])
    assert (state.tangible, state.vanishing) == (1, 2)
    assert state.throughput == close({"wait": 4, "again": 8, "back": 8, "end": 4})


def test_trap_of_immediate_transitions_is_named():
    trap = net("trap", {"a": 1}, t("in", "a", "b", exponential(1)), t("x", "b", "c"), t("y", "c", "b"))
    with pytest.raises(NetError, match=r"without time passing: after in, x -> y repeats"):
        steady_state([trap])


def test_several_recurrent_classes_are_weighted_by_absorption():
    """1 to 3 between a dead end and a circle of two markings."""
    fork = net(
        "fork",
        {"a": 1},
        t("left", "a", "dead", exponential(1)),
        t("right", "a", "b", exponential(3)),
        t("on", "b", "c", exponential(1)),
        t("off", "c", "b", exponential(1)),
    )
    state = steady_state([fork])
    assert {c.dead: c.probability for c in state.classes} == close({True: 1 / 4, False: 3 / 4})
    assert state.throughput["on"] == close(3 / 8)
    assert state.mean_tokens["dead"] == close(1 / 4)
    assert state.mean_tokens["a"] == 0


def test_priority_and_weight_of_immediate_transitions():
    choice = net(
        "choice",
        {"a": 1},
        t("go", "a", "b", exponential(1)),
        t("never", "b", "a", priority=-1),
        t("rare", "b", "a", weight=0.25),
        t("often", "b", "a", weight=0.75),
        t("last_resort", "b", "a", weight=0.0),
    )
    flow = steady_state([choice]).throughput
    assert flow == close({"go": 1, "never": 0, "rare": 1 / 4, "often": 3 / 4, "last_resort": 0})


def test_means_decide_where_one_thing_happens_at_a_time():
    delays = [Delay("constant", (2.0,)), Delay("uniform", (1.0, 3.0)), Delay("gamma", (4.0, 0.25))]
    ring = net("ring", {"p0": 1}, *(t(f"t{i}", f"p{i}", f"p{(i + 1) % 3}", d) for i, d in enumerate(delays)))
    state = steady_state([ring])
    assert state.throughput["t0"] == close(1 / 5)
    assert state.marked["p2"] == close(1 / 5)


def test_other_delays_beside_each_other_are_refused():
    queue = net(
        "md1",
        {"free": 5},
        t("arrive", "free", "queue", exponential(2)),
        t("serve", "queue", "free", Delay("constant", (0.5,))),
    )
    with pytest.raises(NetError, match=r"serve \(constant\(value 0.5\)\) run beside others.*simulate --summary"):
        steady_state([queue])


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (net("untimed", {"a": 1}, t("x", "a", "a")), "no transition of untimed has a delay"),
        (net("w", {"a": 1}, t("x", "a", "a", exponential(1), weight=-1.0)), "weight -1.0 of transition x"),
        (net("open", {}, t("x", "", "a", exponential(1))), "more than 500 markings; place a has come to 499 tokens"),
    ],
)
def test_what_cannot_be_computed_says_why(bad, message):
    with pytest.raises(NetError, match=message):
        steady_state([bad], states=500)


def test_large_chains_agree_with_the_product_form():
    """Closed ring of exponential servers: shares are products of powers of 1/rate (Gordon, Newell, 1967)."""
    rates, tokens = (1.0, 1.3, 0.8, 2.0), 22
    ring = net(
        "ring", {"p0": tokens}, *(t(f"t{i}", f"p{i}", f"p{(i + 1) % 4}", exponential(r)) for i, r in enumerate(rates))
    )
    state = steady_state([ring])
    assert state.tangible == math.comb(tokens + 3, 3) > 2000
    normal = [1.0] + [0.0] * tokens
    for rate in rates:
        for n in range(1, tokens + 1):
            normal[n] += normal[n - 1] / rate
    assert state.throughput["t2"] == pytest.approx(normal[tokens - 1] / normal[tokens], rel=1e-10)
    mean = sum(normal[tokens - k] / normal[tokens] / rates[2] ** k for k in range(1, tokens + 1))
    assert state.mean_tokens["p2"] == pytest.approx(mean, rel=1e-9)


@pytest.mark.parametrize("servers", [1, 2, LARGEST])
@pytest.mark.parametrize("acts", [False, True])
def test_machines_and_their_repairers(servers, acts):
    """Birth and death: each working machine may fail, and as many are mended as there are people (M/M/s//N)."""
    machines, fails, mends = 5, 0.3, 1.0
    action = {"action": FunctionAction("f"), "on_failure": {"works": 1}, "success": 1.0} if acts else {}
    nets = [
        net(
            "repair",
            {"works": machines},
            t("fail", "works", "broken", exponential(fails), servers=LARGEST),
            t("mend", "broken", "works", exponential(mends), servers=servers, **action),
        )
    ]
    shares = [1.0]
    for broken in range(1, machines + 1):
        shares.append(shares[-1] * (machines - broken + 1) * fails / (min(broken, servers) * mends))
    working = sum((machines - broken) * share for broken, share in enumerate(shares)) / sum(shares)
    state = steady_state(nets)
    assert state.mean_tokens["works"] == close(working)
    throughput = state.throughput["mend.end" if acts else "mend"]
    assert throughput == close(fails * working)
    played = summarise(nets, seed=3, until=20_000.0).mean_tokens["works"]
    assert abs(played.mean - working) < 3.0 * played.half_width


def test_queue_that_mixes_slowly():
    """A long birth-death chain, on which sweeps hardly converge."""
    n, ratio = 5000, 2.0 / 2.002
    queue = net(
        "mm1k",
        {"free": n},
        t("arrive", "free", "queue", exponential(2)),
        t("serve", "queue", "free", exponential(2.002)),
    )
    expected = ratio / (1 - ratio) - (n + 1) * ratio ** (n + 1) / (1 - ratio ** (n + 1))
    assert steady_state([queue]).mean_tokens["queue"] == pytest.approx(expected, rel=1e-6)


@st.composite
def stochastic_nets(draw):
    """Nets that keep the number of their tokens: one token in, one out; exponential or immediate."""
    n = draw(st.integers(2, 4))
    places = [f"p{i}" for i in range(n)]
    parts = []
    for i in range(draw(st.integers(2, 7))):
        source, target = draw(st.sampled_from(places)), draw(st.sampled_from(places))
        rate = draw(st.none() | st.integers(1, 5))
        extra = {"weight": float(draw(st.integers(1, 4))), "priority": draw(st.integers(0, 1))} if rate is None else {}
        both = draw(st.booleans())
        inputs, outputs = (f"{source} {target}", f"{target} {target}") if both else (source, target)
        parts.append(t(f"t{i}", inputs, outputs, None if rate is None else exponential(float(rate)), **extra))
    parts.append(t("on", places[0], places[-1], exponential(1.0)))
    parts.append(t("home", places[-1], places[0], exponential(1.0)))
    return net("random", {places[0]: draw(st.integers(1, 3))}, *parts)


def reference(one):
    """Long-run rates of firing from the uniformised jump chain, all markings in one dense matrix."""
    compiled = compile_net(one)
    parts = list(one.transitions.values())
    states = [compiled.marking_vector(one.initial_marking())]
    moves = []
    for state in states:
        enabled = [i for i in range(len(parts)) if compiled.enabled(state, i)]
        instant = [i for i in enabled if parts[i].delay is None]
        if instant:
            top = max(parts[i].priority for i in instant)
            chosen = {i: parts[i].weight for i in instant if parts[i].priority == top}
        else:
            chosen = {i: parts[i].delay.values[0] for i in enabled}
        total = sum(chosen.values())
        row = []
        for i, amount in chosen.items():
            after = compiled.fire(state, i)
            if after not in states:
                states.append(after)
            row.append((i, states.index(after), amount / total))
        moves.append((row, 0.0 if instant else (1.0 / total if total else math.inf)))
    jump = np.zeros((len(states), len(states)))
    for s, (row, _) in enumerate(moves):
        for _, target, p in row:
            jump[s, target] += p
        if not row:
            jump[s, s] = 1.0
    bottoms = list(nx.attracting_components(nx.from_numpy_array(jump, create_using=nx.DiGraph)))
    stay = np.array([time for _, time in moves])
    if any(stay[list(bottom)].max() == 0.0 for bottom in bottoms):
        return "trap"
    if len(bottoms) > 1 or math.isinf(stay[next(iter(bottoms[0]))]):
        return "several"
    visits = np.linalg.matrix_power(0.5 * jump + 0.5 * np.eye(len(states)), 2**40)[0]
    time = float(visits @ stay)
    return {
        part.name: sum(visits[s] * p for s, (row, _) in enumerate(moves) for i, _, p in row if i == n) / time
        for n, part in enumerate(parts)
    }


@settings(max_examples=60, deadline=None)
@given(stochastic_nets())
def test_random_nets_agree_with_a_dense_solution(one):
    expected = reference(one)
    if expected == "trap":
        with pytest.raises(NetError, match="without time passing"):
            steady_state([one])
        return
    state = steady_state([one])
    if expected == "several":
        assert len(state.classes) > 1 or state.classes[0].dead
        return
    for name, value in expected.items():
        assert float(state.throughput[name]) == pytest.approx(value, rel=1e-6, abs=1e-9)
    tokens = sum(one.initial_marking().values())
    assert sum(state.mean_tokens.values()) == close(tokens)
    assert sum(share for _, share in state.probability) == close(1)


@pytest.mark.parametrize(("then", "rate"), [("skip", 0.15), ("restart", 0.1), ("fail", 0.15)])
def test_an_interrupt_is_a_race_of_the_action_with_its_condition(then, rate):
    """The action takes 10 s, the condition after 20 s: one of them every 20/3 s, the action two times in three."""
    state = steady_state(
        [
            parse_net(
                "net: n\nplaces: {wanted: 1, there: , failed: }\ninterrupts:\n  seen:\n    during: reach\n"
                "    watch: {name: /seen, type: std_msgs/msg/Bool}\n    delay: {exponential: {mean: 20}}\n"
                f"    then: {then}\ntransitions:\n"
                "  reach: {in: wanted, out: there, action: r, on_failure: failed, delay: {exponential: {mean: 10}}}\n"
                "  again: {in: there, out: wanted}\n  failed: {in: failed, out: wanted}\n"
            )
        ]
    )
    assert state.throughput["again"] + state.throughput.get("failed", 0.0) == close(rate)
    assert state.throughput["reach.seen.stop"] == close(0.05)
