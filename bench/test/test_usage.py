import os

import pytest

from bench.usage import memory_mib


def test_memory_of_this_process_is_between_one_and_a_thousand_mib():
    assert 1.0 < memory_mib([os.getpid()]) < 1000.0
    assert memory_mib([2**30]) == pytest.approx(0.0)
