"""Parameters of a node: described, of one type, within a range, and closed where a change would have no effect."""

import pytest
from rcl_interfaces.msg import ParameterType
from rclpy.parameter import Parameter

from im_core.processes.agent_socket import AgentOrder
from im_core.processes.startup import StartupPhase
from im_core.ros.node import ManagedNode


class Oven(ManagedNode):
    """Reads a parameter of each type when it is made."""

    def __init__(self, **given):
        overrides = [Parameter(name, value=value) for name, value in {"standalone": True, **given}.items()]
        super().__init__("oven", parameter_overrides=overrides)
        declare = self.declared.declare
        self.heat = declare("heat", 0.5, "of the oven [kW]", span=(0.0, 2.0))
        self.trays = declare("trays", 1, "how many are in use", span=(1, 3))
        self.mode = declare("mode", "grill", "what it does", known=("grill", "bake"))
        self.open = declare("open", False, "whether its door is open")

    def phase_configure(self):
        self.declared.declare("fan", 1.0, "of its speed", span=(0.0, 2.0), changeable=True)


def test_each_has_a_description_a_type_and_a_range(ros):
    node = ros(Oven(heat=1, mode="bake"))
    assert (node.heat, node.trays, node.mode, node.open) == (1.0, 1, "bake", False)
    told = {name: node.describe_parameter(name) for name in node.get_parameters_by_prefix("")}
    assert all(descriptor.description for descriptor in told.values())
    assert all(descriptor.type != ParameterType.PARAMETER_NOT_SET for descriptor in told.values())
    assert told["heat"].type == ParameterType.PARAMETER_DOUBLE
    (heat,), (trays,) = told["heat"].floating_point_range, told["trays"].integer_range
    assert (heat.from_value, heat.to_value, trays.from_value, trays.to_value) == (0.0, 2.0, 1, 3)
    assert told["mode"].additional_constraints == "one of grill, bake"


def test_a_change_that_would_have_no_effect_is_refused(ros):
    node = ros(Oven())
    for name, value in (("heat", 1.0), ("standalone", False), ("introspection", "contents")):
        (result,) = node.set_parameters([Parameter(name, value=value)])
        assert (result.successful, "read-only" in result.reason) == (False, True)
    (result,) = node.set_parameters([Parameter("use_sim_time", value=True)])
    assert result.successful


def test_a_parameter_that_may_be_changed_is_checked_at_the_start_too(ros, wait_until):
    node = ros(Oven(fan=2))
    wait_until(lambda: node.ready, "the node to be ready")
    for value, allowed in ((0.5, True), (3.0, False)):
        (result,) = node.set_parameters([Parameter("fan", value=value)])
        assert result.successful == allowed
    assert node.get_parameter("fan").value == 0.5


@pytest.mark.raises
def test_whatever_a_phase_raises_the_node_says_that_it_has_failed(ros, wait_until):
    class Broken(Oven):
        def phase_start(self):
            raise KeyError("gone")

        def phase_shutdown(self):
            raise ZeroDivisionError

    node = ros(Broken())
    wait_until(lambda: node.failed, "the node to fail")
    assert node.failed == "KeyError: 'gone'"
    node.shut_down_once()


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"heat": "hot"}, "parameter heat of /oven is 'hot', not a number"),
        ({"heat": float("nan")}, "heat nan of /oven is not between 0 and 2"),
        ({"trays": 4}, "trays 4 of /oven is not between 1 and 3"),
        ({"trays": 1.5}, "parameter trays of /oven is 1.5, not a whole number"),
        ({"open": 1}, "parameter open of /oven is 1, not true or false"),
        ({"mode": "gril"}, "there is no value of the parameter mode of /oven 'gril'; did you mean 'grill'?"),
        ({"fan": "fast"}, "parameter fan of /oven is 'fast', not a number"),
        ({"fan": 5.0}, "fan 5.0 of /oven is not between 0 and 2"),
        ({"introspection": "all"}, "there is no value of the parameter introspection of /oven 'all' (known: contents,"),
    ],
)
def test_a_wrong_value_fails_the_node_with_a_sentence(ros, wait_until, given, sentence):
    node = ros(Oven(**given))
    wait_until(lambda: node.failed, "the node to refuse")
    assert node.failed.startswith(sentence)


def test_what_a_deployment_gives_and_the_node_does_not_have_is_refused(ros, wait_until):
    node = Oven(standalone=False, haet=1.0)
    node.alarms.after(0.0, lambda: node.obey(AgentOrder(int(StartupPhase.CONFIGURE), {})))
    ros(node)
    wait_until(lambda: node.failed, "the node to refuse")
    assert node.failed.startswith("there is no parameter of /oven 'haet'; did you mean 'heat'? (known: fan, heat, ")
