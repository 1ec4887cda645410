"""The best choices: against value iteration, every policy in turn, and the steady state of the same net."""

import itertools
import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_pnt.errors import NetError
from im_pnt.netfile import load_net, parse_net
from im_pnt_analysis.cli import main
from im_pnt_analysis.timed.policy import Rewards, best_policy
from im_pnt_analysis.timed.steady import steady_state
from support.fixtures import NETS

ACTION = st.tuples(st.integers(0, 3), st.integers(1, 9), st.sampled_from([0.3, 0.5, 0.9]), st.integers(-3, 5))
"""Place it leads to, mean time [s], probability of success, reward; a failure leads back to the first place."""

PLANS = st.lists(st.lists(ACTION, min_size=1, max_size=3), min_size=4, max_size=4)
"""For each of four places what can be done there."""


def plan_net(plan, *, command=False):
    """One token, and in each place some actions; place 3 is the end of the command, or leads back."""
    lines = ["net: n", "places: {start: 1, p0: , p1: , p2: , p3: }", "transitions:"]
    lines.append("  begin: {in: start, out: p0" + (", symbol: go}" if command else "}"))
    lines.append("  end: {in: p3, out: start" + (", emit: go_done}" if command else "}"))
    for place, actions in enumerate(plan[:3]):
        for rank, (to, mean, success, _) in enumerate(actions):
            lines.append(
                f"  t{place}_{rank}: {{in: p{place}, out: p{to}, on_failure: p0, action: do, success: {success},"
                f" delay: {{exponential: {{mean: {mean}}}}}}}"
            )
    return parse_net("\n".join(lines))


def gains(plan):
    return {
        f"t{place}_{rank}": float(each[3])
        for place, actions in enumerate(plan[:3])
        for rank, each in enumerate(actions)
    }


@settings(max_examples=40, deadline=None)
@given(PLANS)
def test_the_soonest_answer_is_that_of_value_iteration(plan):
    """With each place's shortest expected time to the end: place 3 of them has to be reachable at all."""
    plan[2].append((3, 5, 0.5, 0))
    plan[0].append((2, 7, 0.5, 0))
    times = np.zeros(4)
    for _ in range(20_000):
        best = [
            min(mean + success * times[to] + (1.0 - success) * times[0] for to, mean, success, _ in plan[place])
            for place in range(3)
        ]
        change = float(np.max(np.abs(np.array([*best, 0.0]) - times)))
        times = np.array([*best, 0.0])
        if change < 1e-12:
            break
    policy = best_policy([plan_net(plan, command=True)], Rewards({}, {}, -1.0), command="go")
    assert policy.value == pytest.approx(-times[0], rel=1e-6)
    assert policy.value >= policy.present - 1e-6 * abs(policy.present)


def average(plan, choice, rewards):
    """Reward a second of a policy: of what comes between two beginnings, over its time."""
    matrix, gained, took = np.zeros((4, 4)), np.zeros(4), np.zeros(4)
    for place, rank in enumerate(choice):
        to, mean, success, _ = plan[place][rank]
        gained[place], took[place] = success * rewards[f"t{place}_{rank}"], mean
        matrix[place, to] += success
        matrix[place, 0] += 1.0 - success
    matrix[3, 0] = 1.0  # at once: back to the first place
    matrix[:, 0] = 0.0  # a round is over there
    visits = np.linalg.solve(np.eye(4) - matrix.T, np.eye(4)[0])
    return float(visits @ gained / (visits @ took))


@settings(max_examples=40, deadline=None)
@given(PLANS)
def test_the_most_a_second_is_that_of_the_best_of_all_policies(plan):
    rewards = gains(plan)
    every = itertools.product(*(range(len(actions)) for actions in plan[:3]))
    best = max(average(plan, choice, rewards) for choice in every)
    policy = best_policy([plan_net(plan)], Rewards(rewards, {}))
    assert policy.value == pytest.approx(best, rel=1e-6, abs=1e-8)
    assert policy.value >= policy.weighted - 1e-6
    state = steady_state([plan_net(plan)])
    now = sum(value * state.throughput[f"{name}.end"] for name, value in rewards.items())
    assert policy.present == pytest.approx(now, rel=1e-6, abs=1e-8), "by elimination, with the weights as they are"


def test_rewards_of_places_count_tokens_and_time():
    molloy, wanted = load_net(NETS / "molloy.yaml"), {"p5": 2.0, "p2": -1.0}
    state = steady_state([molloy])
    policy = best_policy([molloy], Rewards({}, wanted))
    assert policy.present == pytest.approx(2.0 * state.mean_tokens["p5"] - state.mean_tokens["p2"], rel=1e-6)


def test_a_choice_for_good_is_made_for_the_better_of_two_lives():
    """What is chosen first decides for ever: most policies divide the markings into classes."""
    net = parse_net(
        "net: n\nplaces: {start: 1, a: , b: }\ntransitions:\n  to_a: {in: start, out: a}\n  to_b: {in: start, out: b}\n"
        "  work_a: {in: a, out: a, delay: {exponential: {mean: 1}}}\n"
        "  work_b: {in: b, out: b, delay: {exponential: {mean: 2}}}"
    )
    policy = best_policy([net], Rewards({"work_a": 1.0, "work_b": 4.0}, {}))
    assert (policy.value, policy.present) == (pytest.approx(2.0, rel=1e-6), pytest.approx(1.5, rel=1e-6))
    (decision,) = policy.decisions
    assert decision.options == {"to_a": pytest.approx(0.0, abs=1e-6), "to_b": pytest.approx(1.0, rel=1e-6)}


def test_a_choice_that_would_never_end_is_not_made():
    net = parse_net(
        "net: n\nplaces: {idle: 1, at: , waited: }\ntransitions:\n  begin: {symbol: go, in: idle, out: at}\n"
        "  wait: {in: at, out: waited}\n  go_on: {in: waited, out: at, delay: 1}\n"
        "  end: {in: at, out: idle, emit: go_done}"
    )
    policy = best_policy([net], Rewards({}, {}, -1.0), command="go")
    assert (policy.value, policy.present) == (pytest.approx(0.0, abs=1e-9), pytest.approx(-1.0, rel=1e-6))
    paid = best_policy([net], Rewards({"go_on": 1.0}, {}, -2.0), command="go")
    assert [decision.options for decision in paid.decisions] == [{"wait": 0.0, "end": 1.0}]


SHELF = """
net: shelf
places: {robot: 1, far: 2, near: 2, chosen_far: , chosen_near: , back: }
transitions:
  fetch_far: {in: [robot, far], out: chosen_far}
  fetch_near: {in: [robot, near], out: chosen_near}
  go_far: {in: chosen_far, out: [robot, back], delay: {exponential: {mean: 10}}}
  go_near: {in: chosen_near, out: [robot, back], delay: {exponential: {mean: 2}}}
  fill_far: {in: back, out: far, delay: {exponential: {mean: 4}}, servers: inf}
  fill_near: {in: back, out: near, delay: {exponential: {mean: 40}}, servers: inf}
"""


def test_what_is_best_may_depend_on_the_marking():
    """Every marking with a decision in turn, as weights of copies would say it: no other assignment gains more."""
    policy = best_policy([parse_net(SHELF)], Rewards({"go_far": 4.0, "go_near": 1.0}, {}))
    assert policy.value > policy.weighted - 1e-9
    assert policy.value > policy.present
    for decision in policy.decisions:
        assert set(decision.options) == {"fetch_far", "fetch_near"}
        assert math.isclose(sum(decision.options.values()), 1.0)


@pytest.mark.parametrize(
    ("text", "rewards", "command", "complaint"),
    [
        (SHELF, Rewards({"go_fra": 1.0}, {}), None, r"there is no transition 'go_fra' \(did you mean 'go_far'\?\)"),
        (SHELF, Rewards({}, {"faar": 1.0}), None, r"there is no place 'faar' \(did you mean 'far'\?\)"),
        (
            "net: n\nplaces: {a: 1, b: }\ntransitions:\n  go: {symbol: go, in: a, out: b}\n"
            "  d: {in: b, out: a, emit: go_done}",
            Rewards({}, {}, -1.0),
            "stop",
            "no transition of n reads the symbol 'stop'",
        ),
        (
            "net: n\nplaces: {a: 1, b: , c: }\ntransitions:\n  go: {symbol: go, in: a, out: b}\n"
            "  t: {in: b, out: c, delay: 1}\n  back: {in: c, out: b, delay: 1}\n"
            "  d: {in: [b, c], out: a, emit: go_done}",
            Rewards({}, {}, -1.0),
            "go",
            "whatever is chosen, the command may never end",
        ),
        (
            "net: n\nplaces: {a: 1, b: }\ntransitions:\n  t: {in: a, out: a}\n  u: {in: a, out: b}\n"
            "  w: {in: b, out: a, delay: 1}",
            Rewards({"t": 1.0}, {}),
            None,
            "there is no limit to what can be gained",
        ),
        (
            "net: n\nplaces: {a: 1, b: }\ntransitions:\n  t: {in: a, out: b}\n  u: {in: b, out: a}",
            Rewards({"t": 1.0}, {}),
            None,
            "whatever is chosen, no time passes",
        ),
    ],
)
def test_what_cannot_be_computed_says_why(text, rewards, command, complaint):
    with pytest.raises(NetError, match=complaint):
        best_policy([parse_net(text)], rewards, command=command)


DOOR = """
net: door
places: {robot: 1, at_door: , within: }
transitions:
  begin: {symbol: enter, in: robot, out: at_door}
  knock: {in: at_door, out: within, action: k, delay: {exponential: {mean: 10}}, success: 0.9, on_failure: at_door}
  push: {in: at_door, out: within, action: p, delay: {exponential: {mean: 4}}, success: 0.3, on_failure: at_door}
  done: {in: within, out: robot, emit: enter_done}
"""


def test_the_command_prints_the_choices_and_weights_that_make_them(tmp_path, capsys):
    file = tmp_path / "door.yaml"
    file.write_text(DOOR)
    assert main(["policy", str(file), "--command", "enter"]) == 0
    printed = capsys.readouterr().out.splitlines()
    assert printed[:2] == [
        "door: -11.1111 each enter with the best choices",
        "  as it is       -11.6667, with the weights of the net",
    ]
    assert "  choose         knock (not push) with at_door=1" in printed
    assert main(["policy", str(file), "--reward", "done=5", "--reward", "at_door=-1/s", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["weights"] == {"knock": 1.0, "push": 1e-06}
    assert main(["policy", str(file), "--command", "enter", "--choose", "knock"]) == 0
    assert "there is nothing to choose" in capsys.readouterr().out
    for wrong in (["--reward", "done"], ["--reward", "=4"], []):
        assert main(["policy", str(file), *wrong]) == 2


FLOW = "  grasp_from_side: {in: seen, out: held, weight: 3}\n"
BLOCK = "  grasp_from_side:\n    # the better one\n    in: seen\n    out: held\n"
NEXT = "  grasp_from_side:\n    {in: seen, out: held}\n"


@pytest.mark.parametrize("side", [FLOW, BLOCK, NEXT], ids=["flow", "block", "next line"])
def test_weights_are_written_into_the_file_and_used(tmp_path, capsys, side):
    file = tmp_path / "pick.yaml"
    text = (
        "net: pick   # a picker\nplaces: {idle: 1, seen: , held: }\ntransitions:\n"
        "  see: {symbol: pick, in: idle, out: seen}\n"
        "  grasp_from_above:   {in: seen, out: slow}\n" + side + "  lift: {in: slow, out: held, delay: 9}\n"
        "  end: {in: held, out: idle, emit: pick_done}\n"
    ).replace("held: }", "held: , slow: }")
    file.write_text(text)
    asked = ["policy", str(file), "--command", "pick", "--choose", "grasp_from_above", "grasp_from_side", "--write"]
    assert main(asked) == 0
    told = capsys.readouterr().out
    weights = {name: load_net(file).transitions[name].weight for name in ("grasp_from_above", "grasp_from_side")}
    assert f"grasp_from_above {weights['grasp_from_above']:g}, grasp_from_side {weights['grasp_from_side']:g}" in told
    assert weights["grasp_from_above"] < 0.01 < weights["grasp_from_side"]
    kept = [line for line in file.read_text().splitlines() if "weight" not in line]
    assert [line for line in text.splitlines() if line not in kept] == [
        line for line in text.splitlines() if ("grasp" in line and "{" in line) or "    {in: seen" in line
    ]
    weighted = told.partition("with weights")[2].split(":")[0].split()[0]
    assert main(asked[:-1]) == 0
    assert capsys.readouterr().out.partition("as it is")[2].split(",")[0].split()[0] == weighted


def test_weights_of_a_part_are_left_to_the_author(tmp_path, capsys):
    file, part = tmp_path / "pick.yaml", tmp_path / "part.yaml"
    part.write_text("transitions: {above: {in: seen, out: slow}, side: {in: seen, out: held}}\n")
    file.write_text(
        "net: pick\ninclude: part.yaml\nplaces: {idle: 1, seen: , slow: , held: }\n"
        "transitions:\n  see: {symbol: pick, in: idle, out: seen}\n  lift: {in: slow, out: held, delay: 9}\n"
        "  end: {in: held, out: idle, emit: pick_done}\n"
    )
    before = file.read_text(), part.read_text()
    assert main(["policy", str(file), "--command", "pick", "--write"]) != 0
    assert "write the weights yourself" in capsys.readouterr().err
    assert (file.read_text(), part.read_text()) == before
