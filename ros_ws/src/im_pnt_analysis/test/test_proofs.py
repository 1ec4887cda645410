"""What was proved is not proved again while it is unchanged; and a cache that is no good is none."""

import shutil
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from im_pnt.errors import VerificationError
from im_pnt.model.groups import group_of, groups
from im_pnt.netfile import parse_net, yaml_text
from im_pnt.verification import accept
from im_pnt_analysis.cli import main
from im_pnt_analysis.cli.terminal import OK, REFUSED, UNPROVED
from im_pnt_analysis.guards.coverage import GuardCoverage
from im_pnt_analysis.search.limits import SearchLimits
from im_pnt_analysis.verify import proofs, verdict
from im_pnt_analysis.verify.load import verify_to_load, verify_to_start

NOTHING = SearchLimits(states=1, seconds=0.0)
RING = "places: {a: 60, b: , c: }\ntransitions: {t: {in: a, out: b}, u: {in: b, out: c}, v: {in: c, out: a}}"

LOOP = parse_net("net: loop\nplaces: {a: 1, b: }\ntransitions: {t: {in: a, out: b}, u: {in: b, out: a}}")


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    folder = tmp_path / "cache"
    monkeypatch.setenv("IM_CACHE_DIR", str(folder))
    monkeypatch.delenv("IM_UNPROVED", raising=False)
    return folder / "proofs"


def ring(name="ring"):
    return parse_net(f"net: {name}\n{RING}")


def ask(name, other):
    return parse_net(
        f"net: {name}\nplaces: {{idle: 1, asked: , done: , failed: }}\n"
        "services: {serve: {entry: asked, done: done, failed: failed}}\ntransitions:\n"
        f"  go: {{symbol: go, in: idle, out: idle, request: {other}.serve, on_failure: idle}}\n"
        "  serve: {in: [asked, idle], out: [done, idle]}"
    )


def test_a_net_that_is_unchanged_is_accepted_with_no_time_to_prove_it():
    assert not verify_to_load([ring()], NOTHING).ok
    first = verify_to_load([ring()])
    again = verify_to_load([ring()], NOTHING)
    again.require_ok()
    assert (again.proved_before, again.states, again.assumptions) == (True, first.states, first.assumptions)
    assert "unchanged since it was verified" in again.sentence
    described = replace(ring(), description="words", source="elsewhere")
    assert verify_to_load([described], NOTHING).ok


def test_what_is_changed_or_proved_by_other_means_is_proved_anew(monkeypatch):
    verify_to_load([ring(), LOOP])
    assert verify_to_load([LOOP, ring()]).proved_before
    assert verify_to_load([ring()]).proved_before  # it was a part of them, and each part is proved by itself
    assert not verify_to_load([parse_net(yaml_text(ring()).replace("60", "61")), LOOP]).proved_before
    monkeypatch.setattr(proofs, "_prover", lambda: "another version")
    assert not verify_to_load([ring(), LOOP]).proved_before


MAID = """
net: maid
places: {asked: , seen: , done: , failed: , tool: {tokens: 1, resource: true}}
services: {work: {entry: asked, done: done, failed: failed, arguments: {x: {type: number}}}}
transitions:
  begin: {in: [asked, tool], out: seen}
  small: {in: seen, out: [done, tool], guard: "${arguments.x < 3}"}
  large: {in: seen, out: [failed, tool], guard: "${arguments.x >= 3}"}
"""
CALLER = """
net: caller
places: {idle: 1}
transitions: {ask: {symbol: go, in: idle, out: idle, request: maid.work, on_failure: idle, guard: "${arguments.x > 0}"}}
commands: {go: {arguments: {x: {type: number}}}}
"""


def test_nets_that_were_proved_alone_are_neither_searched_nor_decided_again_together(cache, monkeypatch):
    def nets():
        return [parse_net(MAID), parse_net(CALLER)]

    *_, unaided = verify_to_start(nets())
    shutil.rmtree(cache)
    for net in nets():
        verify_to_load([net]).require_ok()

    def repeated(*_, **__):
        raise AssertionError("this was found out before")

    monkeypatch.setattr(GuardCoverage, "check", repeated)
    monkeypatch.setattr(verdict, "Search", repeated)
    *_, together = verify_to_start(nets())
    assert (together.nets, together.ok, together.proved_before) == (["maid", "caller"], True, False)
    assert (together.states, together.assumptions) == (unaided.states, unaided.assumptions)


def test_a_refusal_is_no_proof_and_is_found_again():
    stuck = parse_net("net: stuck\nplaces: {a: 1, b: }\ntransitions: {t: {in: a, out: b}}")
    for _ in range(2):
        report = verify_to_load([stuck])
        assert report.refusals[0].sequence == ("t",)
        assert not report.unproved


ANOTHER = b'{"fingerprint": "x", "states": 1, "assumptions": []}'


@pytest.mark.parametrize("damage", [b"", b"{", b"\xff\xfe", b"[]", ANOTHER])
def test_a_damaged_cache_is_none(cache, damage):
    verify_to_load([ring()])
    (file,) = cache.glob("*.json")
    file.write_bytes(damage)
    assert not verify_to_load([ring()]).proved_before
    assert verify_to_load([ring()], NOTHING).ok  # the damage was mended


def test_a_cache_that_cannot_be_is_none(cache):
    cache.parent.write_text("a file where the folder should be")
    for _ in range(2):
        report = verify_to_load([ring()])
        assert report.ok
        assert not report.proved_before


def test_the_cache_keeps_the_newest_proofs(cache, monkeypatch):
    monkeypatch.setattr(proofs, "MOST", 3)
    for i in range(6):
        verify_to_load([ring(f"n{i}")])
    assert len(list(cache.glob("*.json"))) == 3
    assert verify_to_load([ring("n5")], NOTHING).ok


def test_what_is_not_proved_is_accepted_where_the_machine_is_started_so(monkeypatch):
    report = verify_to_load([ring()], NOTHING)
    assert report.unproved
    with pytest.raises(VerificationError, match=r"net ring is not proved: whether .*: .*--unproved"):
        accept(report)
    monkeypatch.setenv("IM_UNPROVED", "1")
    accept(report)
    stuck = parse_net("net: stuck\nplaces: {a: 1, b: }\ntransitions: {t: {in: a, out: b}}")
    with pytest.raises(VerificationError, match="net stuck is refused"):
        accept(verify_to_load([stuck]))


def test_nets_that_deadlock_only_together_are_refused_for_a_start():
    nets = [ask("one", "two"), ask("two", "one"), ring()]
    reports = list(verify_to_start(nets))
    assert [(report.nets, report.ok) for report in reports[:-1]] == [(["one"], True), (["two"], True), (["ring"], True)]
    assert (reports[-1].nets, reports[-1].refusals[0].kind) == (["one", "two"], "deadlock")


LINKS = st.lists(st.tuples(st.integers(0, 6), st.integers(0, 6)), max_size=10)


@given(LINKS)
def test_groups_are_the_nets_that_can_reach_each_other(links):
    nets = []
    for i in range(7):
        others = [b for a, b in links if a == i]
        asks = "".join(f", t{k}: {{in: a, out: a, request: n{b}.s, on_failure: a}}" for k, b in enumerate(others))
        nets.append(parse_net(f"net: n{i}\nplaces: {{a: 1}}\ntransitions: {{t: {{in: a, out: a}}{asks}}}"))
    reach = {i: {i} for i in range(7)}
    for _ in range(7):
        for a, b in links:
            reach[a] |= reach[b]
            reach[b] |= reach[a]
    found = groups(nets)
    assert sorted(net.name for group in found for net in group) == [f"n{i}" for i in range(7)]
    for group in found:
        for net in group:
            assert {other.name for other in group} == {f"n{i}" for i in reach[int(net.name[1:])]}
    assert {net.name for net in group_of(nets[3], nets)} == {f"n{i}" for i in reach[3]}


@pytest.fixture
def files(tmp_path):
    """Nets ``one`` and ``two`` that ask each other, ``ring``, and ``large``."""
    for net in (ask("one", "two"), ask("two", "one"), ring()):
        (tmp_path / f"{net.name}.yaml").write_text(yaml_text(net))
    (tmp_path / "large.yaml").write_text("net: large\nplaces: {a: 900, b: , c: }\n" + RING.partition("\n")[2])
    return lambda *names: [str(tmp_path / f"{name}.yaml") for name in names]


def test_the_start_of_a_machine_says_what_is_verified_refused_and_not_proved(files, capsys):
    assert main(["verify", "--loaded", *files("one", "ring")]) == OK
    assert capsys.readouterr().out.splitlines()[-1].startswith("2 nets verified in ")
    assert main(["verify", "--loaded", *files("one", "ring")]) == OK
    assert capsys.readouterr().out.splitlines()[-1] == "2 nets unchanged since verified"
    assert main(["verify", "--loaded", *files("one", "two")]) == REFUSED
    assert "nets one, two are refused:\n  refused       it is stuck" in capsys.readouterr().out
    assert main(["verify", "--loaded", "--timeout", "1e-9", *files("large")]) == UNPROVED
    assert capsys.readouterr().out.splitlines()[-1].startswith("net large is not proved: whether ")


def test_verify_says_the_verdict_first_and_the_start_finds_the_proof(files, capsys):
    assert main(["verify", *files("one", "two")]) == REFUSED
    assert capsys.readouterr().out.startswith("one+two: REFUSED\n  refused       it is stuck with ")
    assert main(["verify", "--timeout", "1e-9", *files("large")]) == UNPROVED
    assert capsys.readouterr().out.startswith("large: NOT VERIFIED\n")
    assert main(["verify", *files("ring")]) == OK
    capsys.readouterr()
    assert main(["verify", "--loaded", *files("ring")]) == OK
    assert capsys.readouterr().out.splitlines()[-1] == "1 net unchanged since verified"


def test_verify_composes_only_what_must_be(tmp_path, capsys):
    """Who asks a net that always answers is verified without it, and each net alone before that."""
    caller = tmp_path / "caller.yaml"
    caller.write_text("net: caller\nplaces: {a: 1}\ntransitions: {t: {in: a, out: a, request: maid.s, on_failure: a}}")
    maid = tmp_path / "maid.yaml"
    text = "net: maid\nplaces: {e: , d: , f: , m: {tokens: 1, resource: true}}\n"
    text += "services: {s: {entry: e, done: d, failed: f}}\n"
    maid.write_text(text + "transitions: {do: {in: [e, m], out: [d, m]}}")
    assert main(["verify", str(caller), str(maid)]) == OK
    out = capsys.readouterr().out
    assert out.startswith("caller+maid: verified\n")
    assert "2 parts, each verified by itself" in out
    assert len(out.splitlines()) <= 10
    maid.write_text(text + "transitions: {do: {in: [e, m], out: d}}")
    assert main(["verify", str(caller), str(maid)]) == REFUSED
    assert capsys.readouterr().out.startswith("maid: REFUSED\n")
