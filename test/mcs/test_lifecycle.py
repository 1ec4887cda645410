"""Lifecycle of a node whose transitions take time: what is asked for meanwhile."""

import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState

from im_core.ros.calls import call_blocking
from im_core.ros.guard import GuardedNode
from im_core.ros.node import ManagedNode
from im_mcs.ros.lifecycle import Lifecycle


class Slow(ManagedNode):
    """A node whose transition ``configure`` takes until the first of ``begun`` is done."""

    def __init__(self):
        super().__init__("slow")
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
    client.node = node
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
