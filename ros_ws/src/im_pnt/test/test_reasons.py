"""Why a command failed: what is done to end it can fail, too, and does not hide that."""

import pytest

from im_core.errors import DataError, ImError
from im_pnt.netfile import parse_net
from support.process import Process

NET = """
net: n
places: {arm: 1, there: , missed: , failed: }
transitions:
  go: {symbol: go, in: arm, out: there, action: go, on_failure: missed}
  stop: {in: there, out: arm, action: stop, on_failure: failed, emit: go_done}
  give_up: {in: missed, out: failed, action: stop, on_failure: failed}
  end: {in: failed, out: arm, emit: go_failed}
"""


def failing(error: ImError | None):
    def act(ctx):
        if error is not None:
            raise error

    return act


@pytest.mark.parametrize(
    ("goes", "stops", "code", "message"),
    [
        ("no way", None, "path", "no way"),
        ("no way", "stuck", "path", "no way; give_up failed, too: stuck"),
        (None, "stuck", "data", "stuck"),
    ],
)
def test_a_failure_on_the_way_out_is_told_behind_the_one_that_led_there(goes, stops, code, message):
    actions = {
        "go": failing(goes and ImError(goes, code="path")),
        "stop": failing(stops and DataError(stops)),
    }
    process = Process([parse_net(NET)], actions)
    process.command("n", "go")
    (result,) = process.results
    assert (result.success, result.error.code, result.error.message) == (False, code, message)


def test_a_failure_that_decides_where_tokens_go_is_the_reason_there():
    net = NET.replace("action: stop, on_failure: failed}", "action: stop, on_failure: there}")
    process = Process([parse_net(net)], {"go": failing(DataError("no way")), "stop": failing(DataError("stuck"))})
    process.command("n", "go")
    (result,) = process.results
    assert result.error.message == "stuck"
