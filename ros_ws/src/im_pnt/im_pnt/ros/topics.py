"""Publications as actions of transitions."""

from rclpy.publisher import Publisher

from im_core.ros import qos
from im_pnt.action import Action, TopicAction
from im_pnt.functions import ActionContext
from im_pnt.jobs import Activity
from im_pnt.ros.actions import Surroundings
from im_pnt.ros.fields import fill, interface_class


class TopicActions:
    """Publishes messages; an action has confirmed when the middleware has taken its message."""

    def __init__(self, surroundings: Surroundings) -> None:
        self._surroundings = surroundings
        self._publishers: dict[tuple[str, str], Publisher] = {}

    def prepare(self, action: Action) -> None:
        """Makes the publisher of an action.

        Raises:
            NetError: No such interface.
        """
        assert isinstance(action, TopicAction)
        self._publisher(action)

    async def perform(self, activity: Activity, context: ActionContext) -> None:
        """Publishes one message.

        Raises:
            NetError: A field does not fit.
        """
        action = activity.action
        assert isinstance(action, TopicAction)
        fields = await self._surroundings.fields(action, context)
        self._publisher(action).publish(fill(interface_class(action.type)(), fields, str(action)))

    def _publisher(self, action: TopicAction) -> Publisher:
        key = (action.name, action.type)
        if key not in self._publishers:
            node = self._surroundings.node
            self._publishers[key] = node.create_publisher(interface_class(action.type), action.name, qos.EVENTS)
        return self._publishers[key]
