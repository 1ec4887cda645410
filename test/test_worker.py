"""A worker answers each with its own, in the order of asking, also what came while it waited for who asks again."""

import contextlib
import sys
import threading
from types import SimpleNamespace

import pytest

from im_core.errors import StateError
from im_core.ros.coroutines import Promise
from im_core.ros.worker import Worker


@pytest.mark.parametrize("groups", [[1, 1], [64, 1], [5, 64, 2, 1], [200, 3]])
def test_each_who_asks_is_answered_in_the_order_of_asking_whatever_was_asked_before(groups: list[int]) -> None:
    done: list[int] = []

    def together(works):
        return [work() for work in works]

    node = SimpleNamespace(promise=lambda: Promise(lambda: None), alarms=SimpleNamespace(after=lambda *_: None))
    worker, number = Worker(node, "numbers", 60.0, together), 0
    for count in groups:
        answered, asked = [], []
        for _ in range(count):
            run = worker.run(lambda number=number: done.append(number) or number)
            try:
                promise, event = run.send(None), threading.Event()
            except StopIteration as ended:  # the worker was done before the caller waited
                answered.append(ended.value == number)
            else:
                promise.add_done_callback(lambda _, event=event: event.set())
                asked.append((number, promise, event))
            number += 1
        for expected, promise, event in asked:
            assert event.wait(10.0)
            answered.append(promise.result() == expected)
        assert all(answered)
    last = worker.run(lambda: done.append(number))
    with contextlib.suppress(StopIteration):
        last.send(None)
    assert worker.close(10.0)
    assert done == list(range(number + 1))


def test_what_ends_an_interpreter_does_not_end_the_worker() -> None:
    """A thread that SystemExit ends says nothing, and whoever asked after that waited in vain."""

    def together(works):
        return [work() for work in works]

    node = SimpleNamespace(promise=lambda: Promise(lambda: None), alarms=SimpleNamespace(after=lambda *_: None))
    worker = Worker(node, "numbers", 60.0, together)
    for work, expected in ((sys.exit, StateError), (lambda: 7, None)):
        promise, event = worker.run(work).send(None), threading.Event()
        promise.add_done_callback(lambda _, event=event: event.set())
        assert event.wait(10.0)
        assert expected is None or isinstance(promise.exception(), expected)
    assert promise.result() == 7
    assert worker.close(10.0)
