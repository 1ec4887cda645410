import os
import threading
import time

import pytest

from bench.usage import cpu_s, memory_mib


def test_memory_of_this_process_is_between_one_and_a_thousand_mib():
    assert 1.0 < memory_mib([os.getpid()]) < 1000.0
    assert memory_mib([2**30]) == pytest.approx(0.0)


def test_cpu_time_of_a_process_has_that_of_threads_that_ended():
    """A node answers many a request in a thread of its own."""
    used = []

    def work():
        while time.thread_time() < 0.1:
            pass
        used.append(time.thread_time())

    before = cpu_s(os.getpid())
    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert cpu_s(os.getpid()) - before >= used[0]


def test_a_process_that_has_ended_is_told():
    with pytest.raises(ProcessLookupError, match="no process"):
        cpu_s(2**22 + 1)
