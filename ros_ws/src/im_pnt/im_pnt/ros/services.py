"""Service calls as actions of transitions."""

from rclpy.client import Client

from im_core.clock import monotonic
from im_pnt.action import Action, ServiceAction
from im_pnt.functions import ActionContext
from im_pnt.jobs import Activity
from im_pnt.ros.actions import Surroundings, require_success, time_left
from im_pnt.ros.fields import fill, interface_class

SERVICE_TIMEOUT_S = 30.0


class ServiceActions:
    """Calls services; an answer with ``success`` false is a failure."""

    def __init__(self, surroundings: Surroundings) -> None:
        self._surroundings = surroundings
        self._clients: dict[str, tuple[Client, float]] = {}

    def prepare(self, action: Action) -> None:
        """Makes the client of an action.

        Raises:
            NetError: No such interface.
        """
        assert isinstance(action, ServiceAction)
        self._client(action)

    async def perform(self, activity: Activity, context: ActionContext) -> None:
        """Calls a service and has its answer handled.

        Raises:
            ImError: It failed, or did not answer in time.
        """
        action = activity.action
        assert isinstance(action, ServiceAction)
        around, (client, made) = self._surroundings, self._client(action)
        request = fill(client.srv_type.Request(), await around.fields(action, context), str(action))
        task = around.task(action)
        what = f"transition {activity.transition}"
        await around.until_ready(client.service_is_ready, made, task, f"the service {action.name} ({what})")
        limit = time_left(activity, SERVICE_TIMEOUT_S)
        response = await around.wait(client.call_async(request), task, limit, f"an answer of {action.name} ({what})")
        require_success(response, str(action))
        await around.handled(action, context, response)

    def _client(self, action: ServiceAction) -> tuple[Client, float]:
        """The client of a service, and when it was made."""
        if action.name not in self._clients:
            client = self._surroundings.node.create_client(interface_class(action.type), action.name)
            self._clients[action.name] = (client, monotonic())
        return self._clients[action.name]
