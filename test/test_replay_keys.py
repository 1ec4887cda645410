"""Keys of a terminal while a bag is replayed."""

import os
import pty
import time

import pytest

from im_bag.playback import JUMP_S, Controls
from im_bag.ros.replay import keys_pressed


@pytest.fixture
def terminal(monkeypatch):
    """What is written to it is typed."""
    typist, there = pty.openpty()
    with open(there, encoding="utf-8") as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        yield typist
    os.close(typist)


@pytest.mark.parametrize(
    ("typed", "steps", "jump_s"),
    [
        (b"...", 3, 0.0),
        (b"\x1b[C\x1b[C\x1b[D.", 1, JUMP_S),
        (b"\x1b.", 1, 0.0),
        (b"\x1b\x1b[C.", 1, JUMP_S),
        (b"\x1b[5~.\xc3\xa4.", 2, 0.0),
    ],
)
def test_all_keys_that_are_typed_at_once_are_pressed(typed, steps, jump_s, terminal, wait_until):
    controls = Controls(paused=True)
    with keys_pressed(controls):
        os.write(terminal, typed)
        wait_until(lambda: controls.steps == steps, "the keys", 10.0)
    assert (controls.jump_s, controls.ended) == (jump_s, False)


def test_esc_alone_neither_does_anything_nor_keeps_the_replay_from_ending(terminal):
    controls = Controls()
    with keys_pressed(controls):
        os.write(terminal, b"\x1b")
        time.sleep(0.5)
    assert controls == Controls(changed=controls.changed)
