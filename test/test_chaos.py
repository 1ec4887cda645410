"""A short run of the chaos bench against the whole machine, with fixed seeds; the long one is ``scripts/chaos.sh``."""

import pytest

pytestmark = pytest.mark.end_to_end


def test_after_kills_commands_end_true_and_the_next_succeeds(script):
    roles = ("servo", "physics", "mcs", "dispatcher")
    options = ("--seed", 2, "--injections", 3, "--kinds", "kill", "--roles", *roles, "--port", 18_083)
    done = script("chaos", *options, timeout=1200.0)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "3 injections" in done.stdout
