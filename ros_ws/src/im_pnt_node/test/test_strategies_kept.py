import errno
import fcntl
import json
import os
import re

import pytest

from im_core.errors import StoreError
from im_core.files import FileError
from im_pnt.execution.strategies import DONE, StrategyOutcome
from im_pnt.model.net import Strategy
from im_pnt.netfile import parse_net
from im_pnt_node.journal.strategies import StrategyStore
from support.process import Process, hold

NET = """
net: n
places: {todo: 1, bad: }
transitions:
  left: {in: todo, out: todo, action: left, on_failure: todo, strategy: {}}
  right: {in: todo, out: todo, action: right, on_failure: todo, strategy: {}, weight: 2}
"""

LEARNS = Strategy()


def store(path, told=None):
    return StrategyStore(path, ([] if told is None else told).append)


def outcome(name, success, strategy=LEARNS, rivals=()):
    return StrategyOutcome(name, strategy, DONE if success else "it slipped", rivals)


def test_the_book_is_kept_from_run_to_run(tmp_path):
    path = tmp_path / "strategies.json"
    book = store(path)
    book.outcome(outcome("n.t@box", True))
    book.outcome(outcome("m.t", False))
    assert store(path).learned == book.learned
    assert store(path).learned["m.t"].last == "it slipped"
    assert [file.name for file in tmp_path.iterdir()] == ["strategies.json"]


def test_a_strategy_is_forgotten_in_all_contexts_or_in_one(tmp_path):
    path = tmp_path / "strategies.json"
    book = store(path)
    for name in ("n.t@box", "n.t@rod", "n.t2", "n.t"):
        book.outcome(outcome(name, True))
    assert book.forget("n.t@rod") == ["n.t@rod"]
    assert book.forget("n.t") == ["n.t", "n.t@box"]
    assert book.forget("n.t") == []
    assert list(store(path).learned) == list(book.learned) == ["n.t2"]


def test_machines_that_learn_in_one_file_lose_nothing_of_each_other(tmp_path, monkeypatch):
    path = tmp_path / "strategies.json"
    one, other = store(path), store(path)
    for _ in range(5):
        one.outcome(outcome("n.t", True))
    other.outcome(outcome("n.u", False))
    with monkeypatch.context() as full:
        full.setattr("im_pnt_node.journal.strategies.write_whole", lambda *_: (_ for _ in ()).throw(OSError("full")))
        with pytest.raises(OSError, match="full"):
            other.outcome(outcome("n.t", False))
    one.outcome(outcome("n.t", True))
    other.outcome(outcome("n.u", False))
    for book in (other, store(path)):
        assert book.learned["n.t"].counts == (7.0, 2.0)
        assert book.learned["n.u"].counts == (1.0, 3.0)
    lock = os.open(tmp_path, os.O_RDONLY)
    fcntl.flock(lock, fcntl.LOCK_EX)
    with pytest.raises(StoreError, match="another machine writes it"):
        one.outcome(outcome("n.u", True))
    os.close(lock)
    one.outcome(outcome("n.u", True))
    assert store(path).learned["n.u"].counts == (3.0, 3.0)


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"strategies": []}', '{"strategies": {"n.t": 1}}',
    '{"strategies": {"n.t": {"successes": -1, "failures": 0}}}', '{"strategies": {"n.t": {"successes": "1"}}}',
    '{"strategies": {"n.t": {"successes": NaN, "failures": 0}}}', "[" * 10000])  # fmt: skip
def test_a_damaged_file_is_named_and_moved_aside_and_learning_goes_on(tmp_path, content):
    path, told = tmp_path / "strategies.json", []
    path.write_text(content)
    book = store(path, told)
    assert len(told) == 1
    assert re.search(r"strategies\.json.*moved to strategies\.json\.damaged-\d+", told[0])
    book.outcome(outcome("n.t", True))
    path.write_text(content)  # in the middle of a run, what is known is kept
    book.outcome(outcome("n.t", True))
    aside = [file for file in tmp_path.iterdir() if file != path]
    assert [file.read_text() for file in aside] == [content, content]
    assert len(told) == 2
    assert store(path).learned["n.t"].counts == (3.0, 1.0)


def test_a_file_that_the_disk_does_not_read_once_is_not_damaged(tmp_path, monkeypatch):
    path = tmp_path / "strategies.json"
    book = store(path)
    book.outcome(outcome("n.t", True))

    def fails(path):
        raise FileError(path, "cannot be read: Input/output error") from OSError(errno.EIO, "Input/output error")

    with monkeypatch.context() as disk:
        disk.setattr("im_pnt_node.journal.strategies.load_json", fails)
        for attempt in (lambda: book.outcome(outcome("n.t", True)), lambda: store(path), lambda: book.forget("n.t")):
            with pytest.raises(FileError, match="Input/output error"):
                attempt()
    book.outcome(outcome("n.t", False))
    assert store(path).learned == book.learned
    assert book.learned["n.t"].counts == (3.0, 2.0)
    assert [file.name for file in tmp_path.iterdir()] == ["strategies.json"]


def test_a_book_that_cannot_be_saved_is_a_trouble_and_no_more(tmp_path):
    book = store(tmp_path / "missing" / "strategies.json")
    process = Process([parse_net(NET)], {"left": hold, "right": hold}, strategies=book)
    process.pump()
    process.end(process.held[0][1].transition)
    assert "cannot be saved" in process.recorder.troubles[0]
    assert json.dumps(process.marking("n"))
