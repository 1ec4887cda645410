"""What holds for all tests, those of the packages and those with nodes."""

import os
import signal
import tempfile

import pytest
from hypothesis import HealthCheck, settings

from im_core import clock
from im_core.processes.end_signals import handle_end_signals

os.environ["IM_FOLDERS"] = tempfile.gettempdir()  # paths in messages may be of the folders of tests

# A verdict is of the code: not of how fast this computer is, nor of which cases are drawn today.
# ``--hypothesis-profile default`` draws other cases each time.
settings.register_profile(
    "same_everywhere", deadline=None, derandomize=True, database=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("same_everywhere")

# A test that is cut short puts away what it has begun, as after Ctrl-C.
handle_end_signals(signal.default_int_handler)


@pytest.fixture
def wait_until():
    """``wait_until(condition, what, seconds)``: returns the first true value of the condition, or fails naming what."""

    def wait(condition, what, seconds=60.0):
        deadline = clock.monotonic() + seconds
        while clock.monotonic() < deadline:
            value = condition()
            if value:
                return value
            clock.sleep(0.02)
        pytest.fail(f"waited {seconds:g} s for {what}, in vain")

    return wait


@pytest.fixture(autouse=True)
def signals_as_before():
    """A test blocks no signal for the tests after it, and for their processes, and leaves no handler of its own."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [])
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    signal.set_wakeup_fd(wakeup := signal.set_wakeup_fd(-1), warn_on_full_buffer=False)
    yield
    for number, handler in handlers.items():
        if handler is not None and signal.getsignal(number) is not handler:
            signal.signal(number, handler)
    signal.set_wakeup_fd(wakeup, warn_on_full_buffer=False)
    assert signal.pthread_sigmask(signal.SIG_SETMASK, before) == before
