import fcntl
import json
import os

import pytest

from im_core.errors import StoreError
from im_pnt.errors import NetError
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


def test_the_book_is_kept_from_run_to_run(tmp_path):
    path = tmp_path / "strategies.json"
    book = StrategyStore(path)
    book.outcome("n", "t", Strategy(decay=0.5), True)
    book.outcome("m", "t", Strategy(), False)
    again = StrategyStore(path)
    assert again.counts("n", "t", Strategy()) == (1.5, 0.5)
    assert again.counts("m", "t", Strategy()) == (1.0, 2.0)
    assert [file.name for file in tmp_path.iterdir()] == ["strategies.json"]


def test_machines_that_learn_in_one_file_lose_nothing_of_each_other(tmp_path, monkeypatch):
    path, strategy = tmp_path / "strategies.json", Strategy()
    one, other = StrategyStore(path), StrategyStore(path)
    for _ in range(5):
        one.outcome("n", "t", strategy, True)
    other.outcome("n", "u", strategy, False)
    with monkeypatch.context() as full:
        full.setattr("im_pnt_node.journal.strategies.write_whole", lambda *_: (_ for _ in ()).throw(OSError("full")))
        with pytest.raises(OSError, match="full"):
            other.outcome("n", "t", strategy, False)
    one.outcome("n", "t", strategy, True)
    other.outcome("n", "u", strategy, False)
    for book in (other, StrategyStore(path)):
        assert book.counts("n", "t", strategy) == (7.0, 2.0)
        assert book.counts("n", "u", strategy) == (1.0, 3.0)
    lock = os.open(tmp_path, os.O_RDONLY)
    fcntl.flock(lock, fcntl.LOCK_EX)
    with pytest.raises(StoreError, match="another machine writes it"):
        one.outcome("n", "u", strategy, True)
    os.close(lock)
    one.outcome("n", "u", strategy, True)
    assert StrategyStore(path).counts("n", "u", strategy) == (3.0, 3.0)


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"strategies": []}', '{"strategies": {"n.t": 1}}',
    '{"strategies": {"n.t": {"successes": -1, "failures": 0}}}', '{"strategies": {"n.t": {"successes": "1"}}}',
    '{"strategies": {"n.t": {"successes": NaN, "failures": 0}}}', "[" * 10000])  # fmt: skip
def test_a_file_that_is_none_is_named(tmp_path, content):
    path = tmp_path / "strategies.json"
    path.write_text(content)
    with pytest.raises(NetError, match=r"strategies\.json"):
        StrategyStore(path)
    assert path.read_text() == content


def test_a_book_that_cannot_be_saved_is_a_trouble_and_no_more(tmp_path):
    book = StrategyStore(tmp_path / "missing" / "strategies.json")
    process = Process([parse_net(NET)], {"left": hold, "right": hold}, strategies=book)
    process.pump()
    process.end(process.held[0][1].transition)
    assert "cannot be saved" in process.recorder.troubles[0]
    assert json.dumps(process.marking("n"))
