"""Functions of a user's own module: ``module:function`` wherever a registered name may stand."""

import pytest

from im_pnt.errors import NetFileError
from im_pnt.netfile import parse_net, yaml_text
from support.process import Process

NET = """
net: n
places: {arm: 1, held: , missed: }
transitions:
  pick: {symbol: pick, in: arm, out: held, action: "gripping:close", guard: "not gripping:warm", on_failure: missed}
  put: {in: held, out: arm, emit: pick_done}
  report: {in: missed, out: arm, emit: pick_failed}
"""
MODULE = """
closed = []
LIMIT = 3
def close(ctx):
    closed.append(ctx.command.symbol)
def warm(ctx):
    return False
"""


@pytest.fixture
def gripping(tmp_path, monkeypatch):
    (tmp_path / "gripping.py").write_text(MODULE)
    (tmp_path / "broken.py").write_text("1 / 0")
    monkeypatch.syspath_prepend(tmp_path)


@pytest.mark.usefixtures("gripping")
def test_an_action_and_a_guard_are_imported_by_their_names():
    process = Process([parse_net(yaml_text(parse_net(NET)))])
    process.command("n", "pick")
    assert process.results[0].success
    import gripping

    assert gripping.closed == ["pick"]


@pytest.mark.usefixtures("gripping")
@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("gripping:close", "griping:close", "action function 'griping:close' cannot .*: No module named 'griping'"),
        ("gripping:close", "gripping:clos", "action function 'gripping:clos' cannot .*has no attribute 'clos'"),
        ("gripping:close", "gripping:LIMIT", "action function 'gripping:LIMIT' is a int, which cannot be called"),
        ("gripping:close", "broken:close", "action function 'broken:close' cannot be loaded: ZeroDivisionError"),
        ("not gripping:warm", "gripping:cold", "guard function 'gripping:cold' cannot be loaded"),
    ],
)
def test_what_is_not_there_is_named_with_its_line(old, new, said):
    with pytest.raises(NetFileError, match=rf"^net:5: transitions\.pick: {said}"):
        Process([parse_net(NET.replace(old, new))])


@pytest.mark.parametrize("written", ["gripping:", ":close", "a b:c", "gripping:close()", "a:b:c"])
def test_what_is_no_name_of_a_function_is_refused_when_the_net_is_read(written):
    with pytest.raises(NetFileError, match=r"transitions.pick.action: .* is neither a name nor module:function"):
        parse_net(NET.replace("gripping:close", written))
