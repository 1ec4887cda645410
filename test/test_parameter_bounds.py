"""Requests to the parameter services of a node: what is too long is refused by its length."""

import pytest
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue, SetParametersResult
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)

from im_core.ros.calls import call_blocking
from im_core.ros.node import ManagedNode
from im_core.ros.parameter_bounds import MOST_CHARACTERS, MOST_NAMES

MANY = 20 * MOST_NAMES
LONG = "x" * (MOST_CHARACTERS + 1)
TOO_MANY_CHARACTERS = f"characters, {MOST_CHARACTERS} are allowed"
TYPES = {
    "byte_array_value": [b"\x01"] * MANY,
    "bool_array_value": [True] * MANY,
    "integer_array_value": [1] * MANY,
    "double_array_value": [1.0] * MANY,
    "string_array_value": ["x"] * MANY,
}


class Oven(ManagedNode):
    """Has a parameter that may be set, and counts how often it was."""

    def __init__(self):
        super().__init__("oven")
        self.declare_parameter("note", "")
        self.asked = 0
        self.add_on_set_parameters_callback(self._count)

    def _count(self, parameters):
        self.asked += 1
        return SetParametersResult(successful=True)


def parameter(name="note", **value):
    return Parameter(name=name, value=ParameterValue(**value))


def text(string, name="note"):
    return parameter(name, type=ParameterType.PARAMETER_STRING, string_value=string)


TOO_LONG = {
    "many": ([text("x")] * MANY, f"{MANY} names and elements, {MOST_NAMES} are allowed"),
    "name": ([text("x", LONG)], TOO_MANY_CHARACTERS),
    "text": ([text(LONG)], TOO_MANY_CHARACTERS),
    "texts": ([parameter(string_array_value=[LONG])], TOO_MANY_CHARACTERS),
    "in all": ([text("x" * 200)] * 600, TOO_MANY_CHARACTERS),
    **{name: ([parameter(**{name: value})], f"{MANY + 1} names and elements") for name, value in TYPES.items()},
}


@pytest.fixture
def oven(ros):
    """``oven(service, ...)``: the answer of the node's service for parameters."""
    node = ros(Oven())
    asker = ros(ManagedNode("asker"))

    def ask(kind, **fields):
        name = SERVICES[kind]
        client = asker.create_client(kind, f"/oven/{name}")
        return call_blocking(client, kind.Request(**fields), 60.0, name)

    ask.node = node
    return ask


SERVICES = {
    DescribeParameters: "describe_parameters",
    GetParameters: "get_parameters",
    GetParameterTypes: "get_parameter_types",
    ListParameters: "list_parameters",
    SetParameters: "set_parameters",
    SetParametersAtomically: "set_parameters_atomically",
}


def test_what_is_set_is_refused_by_its_length(oven):
    for parameters, sentence in TOO_LONG.values():
        (result,) = oven(SetParameters, parameters=parameters).results
        together = oven(SetParametersAtomically, parameters=parameters).result
        assert (result.successful, together.successful) == (False, False)
        assert result.reason == together.reason
        assert sentence in result.reason
    assert oven.node.asked == 0
    assert oven.node.get_parameter("note").value == ""


def test_what_is_asked_for_too_often_is_not_told(oven):
    for names in (["note"] * MANY, ["note", LONG]):
        assert len(oven(GetParameters, names=names).values) == 0
        assert len(oven(GetParameterTypes, names=names).types) == 0
        assert len(oven(DescribeParameters, names=names).descriptors) == 0
        assert len(oven(ListParameters, prefixes=names).result.names) == 0


def test_what_is_short_is_answered_as_rclpy_does(oven):
    lists = {name: value[:5] for name, value in TYPES.items()}
    short = [text("well done"), text("x", "use_sim_time"), *(parameter(**{name: v}) for name, v in lists.items())]
    results = oven(SetParameters, parameters=short).results
    assert [result.successful for result in results] == [True, False] + [False] * len(lists)
    assert oven.node.get_parameter("note").value == "well done"
    assert oven(SetParametersAtomically, parameters=[text("z")]).result.successful
    assert [value.string_value for value in oven(GetParameters, names=["note"] * 3).values] == ["z"] * 3
    assert list(oven(GetParameterTypes, names=["note"]).types) == [ParameterType.PARAMETER_STRING]
    assert oven(DescribeParameters, names=["note"]).descriptors[0].name == "note"
    assert "note" in oven(ListParameters).result.names
