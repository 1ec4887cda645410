"""Lifecycle of a node whose transitions take time: what is asked for meanwhile."""

import pytest
from lifecycle_msgs.msg import Transition, TransitionEvent
from lifecycle_msgs.srv import ChangeState
from rclpy.parameter import Parameter
from service_msgs.msg import ServiceEventInfo

from im_core.ros import qos
from im_core.ros.calls import call_blocking
from im_core.ros.guard import GuardedNode
from im_core.ros.node import ManagedNode
from im_mcs.ros.lifecycle import Lifecycle


class Slow(ManagedNode):
    """A node whose transition ``configure`` takes until the first of ``begun`` is done."""

    def __init__(self):
        super().__init__("slow", parameter_overrides=[Parameter("introspection", value="contents")])
        self.begun = []
        self.lifecycle = Lifecycle(self, {"configure": self._work})

    def destroy_node(self):
        self.lifecycle.destroy()
        super().destroy_node()

    async def _work(self, _):
        self.begun.append(self.promise())
        await self.begun[0]


@pytest.fixture
def ask(ros):
    """A client of the lifecycle of ``ask.node``."""
    node, other = Slow(), GuardedNode("other")
    ros(node, other)
    client = other.create_client(ChangeState, "/slow/change_state")
    assert client.wait_for_service(60.0)
    client.node, node.other = node, other
    return client


def _request(**transition):
    return ChangeState.Request(transition=Transition(**transition))


@pytest.mark.parametrize(
    ("transition", "asked"),
    [
        ({"label": "transition_success"}, "transition_success"),
        ({"id": Transition.TRANSITION_ON_CONFIGURE_SUCCESS}, "transition_success"),
        ({"id": Transition.TRANSITION_CONFIGURE}, "configure"),
    ],
)
def test_a_transition_that_is_under_way_ends_by_its_work_alone(ask, wait_until, transition, asked):
    node, first = ask.node, ask.call_async(_request(label="configure"))
    wait_until(lambda: node.begun, "the transition to begin")
    assert not call_blocking(ask, _request(**transition), 60.0, "change").success
    assert node.lifecycle.failure.endswith(f"'{asked}' is not possible in state configuring; possible: none")
    assert node.lifecycle.state == "configuring"
    node.begun[0].set_result(None)
    assert wait_until(lambda: first.done() and first.result(), "the answer").success
    assert node.lifecycle.state == "inactive"


def test_what_is_asked_of_a_lifecycle_and_where_it_leads_is_told(ask, wait_until):
    """Both are in bags that way."""
    asked, gone = [], []
    listener = ask.node.other
    listener.create_subscription(
        ChangeState.Event, "/slow/change_state/_service_event", asked.append, qos.SERVICE_EVENTS
    )
    listener.create_subscription(TransitionEvent, "/slow/transition_event", gone.append, qos.EVENTS)
    topics = ("/slow/change_state/_service_event", "/slow/transition_event")
    wait_until(lambda: all(map(listener.count_publishers, topics)), "those who tell")
    wait_until(lambda: all(map(ask.node.count_subscribers, topics)), "those who listen")
    first = ask.call_async(_request(label="configure"))
    wait_until(lambda: ask.node.begun, "the transition to begin")
    ask.node.begun[0].set_result(None)
    wait_until(first.done, "the answer")
    wait_until(lambda: len(asked) == len(gone) == 2, "what is told")
    assert [each.info.event_type for each in asked] == [
        ServiceEventInfo.REQUEST_RECEIVED,
        ServiceEventInfo.RESPONSE_SENT,
    ]
    assert asked[0].request[0].transition.label == "configure"
    assert asked[1].response[0].success
    assert [(each.start_state.label, each.transition.label, each.goal_state.label) for each in gone] == [
        ("unconfigured", "configure", "configuring"),
        ("configuring", "transition_success", "inactive"),
    ]
    assert gone[0].timestamp > 0
