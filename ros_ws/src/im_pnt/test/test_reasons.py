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


MENDED = """
net: n
templates:
  put_back:
    ports: {in: wanted, out: done, on_failure: lost}
    places: {felt: }
    transitions:
      feel: {in: wanted, out: felt, action: feel, on_failure: lost}
      put: {in: felt, out: done, action: put, on_failure: lost, tries: 2}
places: {arm: 1, there: , missed: , back: , lost: }
transitions:
  go: {symbol: go, in: arm, out: there, action: go, on_failure: missed}
  stay: {in: there, out: arm, emit: go_done}
  mend: {use: put_back, in: missed, out: back, on_failure: lost, keeps_failure: true}
  end: {in: back, out: arm, emit: go_failed}
  end_lost: {in: lost, out: arm, emit: go_failed}
"""


@pytest.mark.parametrize(
    ("feels", "puts", "message"),
    [
        (None, [None], "no way"),
        ("no hand", [None], "no way; mend.feel failed, too: no hand"),
        (None, ["stuck", None], "no way"),
        (None, ["stuck", "fast"], "no way; mend.put_2 failed, too: fast"),
    ],
)
def test_a_failure_in_mending_is_told_behind_the_one_that_is_mended(feels, puts, message):
    def put(ctx):
        failing(answers.pop(0))(ctx)

    answers = [each and DataError(each) for each in puts]
    functions = {"go": failing(ImError("no way", code="path")), "feel": failing(feels and DataError(feels)), "put": put}
    process = Process([parse_net(MENDED)], functions)
    process.command("n", "go")
    (result,) = process.results
    assert (result.error.code, result.error.message) == ("path", message)


def test_a_failure_that_is_not_kept_is_not_told():
    functions = {
        "go": failing(ImError("no way", code="path")),
        "feel": failing(None),
        "put": failing(DataError("fast")),
    }
    process = Process([parse_net(MENDED.replace(", keeps_failure: true", ""))], functions)
    process.command("n", "go")
    assert process.results[0].error.message == "fast"
