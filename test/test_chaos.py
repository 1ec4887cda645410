"""The shortest run of the chaos bench on the whole machine, with a fixed seed; the long one is ``scripts/chaos.sh``."""

import pytest

pytestmark = pytest.mark.end_to_end


def test_after_a_fault_the_command_ends_true_arms_rest_and_the_next_command_succeeds(script, tmp_path):
    roles, kinds = ("servo", "physics", "mcs", "dispatcher"), ("kill", "lifecycle")
    options = ("--seed", 2, "--injections", 1, "--kinds", *kinds, "--roles", *roles, "--port", 18_083)
    done = script("chaos", *options, "--out", tmp_path / "chaos.jsonl", timeout=1200.0)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "1 injections (1 at factor 0), 0 failures" in done.stdout
