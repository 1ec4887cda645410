"""A command as a command line says it."""

import pytest

from im_core.errors import ConfigError, DataError, NotFoundError
from im_pnt.netfile import parse_net
from im_pnt_node.cli.order import Order

NETS = [
    parse_net(
        """
net: n
places: {a: 1}
commands:
  pick:
    arguments:
      group: {type: string, choices: [left, right], default: left}
      width: {type: number, unit: m, maximum: 0.1}
      joints: {type: numbers, length: 3, default: [0, 0, 0]}
      tags: {type: strings, default: []}
transitions:
  go: {symbol: pick, in: a, out: a, emit: pick_done}
  any: {symbol: any, in: a, out: a, emit: any_done}
"""
    )
]


@pytest.mark.parametrize(
    ("given", "read"),
    [
        (["width=0.02"], {"group": "left", "width": 0.02, "joints": [0, 0, 0], "tags": []}),
        (["width=0", "group=right"], {"group": "right", "width": 0, "joints": [0, 0, 0], "tags": []}),
        (["width=0", "joints=1,2.5,3"], {"group": "left", "width": 0, "joints": [1, 2.5, 3], "tags": []}),
        (["width=0", "joints=[1,2,3]"], {"group": "left", "width": 0, "joints": [1, 2, 3], "tags": []}),
        (["width=0", "tags=7,x=y"], {"group": "left", "width": 0, "joints": [0, 0, 0], "tags": ["7", "x=y"]}),
    ],
)
def test_values_are_read_as_the_net_declares_them(given, read):
    assert Order.read(NETS, "pick", given).arguments == read


def test_a_command_of_which_nothing_is_said_takes_json_or_texts():
    order = Order.read(NETS, "any", ["n=3", "on=true", "name=left", 'deep={"a": [1]}'])
    assert order.arguments == {"n": 3, "on": True, "name": "left", "deep": {"a": [1]}}


@pytest.mark.parametrize(
    ("symbol", "given", "error", "said"),
    [
        ("pik", [], NotFoundError, "there is no command 'pik'; did you mean 'pick'"),
        ("pick", [], DataError, r"command pick: argument width is missing, a number <= 0.1 \[m\]"),
        ("pick", ["width"], ConfigError, "argument 'width' is not of the form name=value"),
        ("pick", ["width=0", "width=0.1"], ConfigError, "argument 'width' is given twice"),
        ("pick", ["width=NaN"], DataError, "argument width is 'NaN', not a number"),
        ("pick", ["width=" + 100_000 * "["], DataError, "argument width is "),
        ("pick", ["width=wide"], DataError, "argument width is 'wide', not a number"),
        ("pick", ["width=0", "grup=left"], DataError, r"pick has no argument 'grup' \(did you mean 'group'\?\)"),
        ("pick", ["width=0", "group=lef"], DataError, "argument group is 'lef', not one of 'left', 'right'"),
        ("pick", ["width=0", "joints=1,2"], DataError, "argument joints has 2 elements, not 3"),
        ("pick", ["width=0", "joints=1 2 3"], DataError, "argument joints is '1 2 3', not a list of 3 numbers"),
    ],
)
def test_what_does_not_fit_is_named(symbol, given, error, said):
    with pytest.raises(error, match=said):
        Order.read(NETS, symbol, given)
