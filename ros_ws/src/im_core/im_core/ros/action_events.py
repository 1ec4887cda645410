"""Goals and results of actions as events on topics, as later ROS has it: rclpy of Jazzy knows it of services only."""

from typing import Any

from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from rclpy.publisher import Publisher
from service_msgs.msg import ServiceEventInfo

from im_core.ros import qos


class ActionEvents:
    """Publishes what one action carries, on ``<action>/_action/send_goal/_service_event`` and ``.../get_result/...``.

    Args:
        node: Its node.
        action_type: Type of the action.
        action_name: Its name.
    """

    def __init__(self, node: Node, action_type: Any, action_name: str) -> None:
        self._node = node
        self._goal_type, self._result_type = action_type.Impl.SendGoalService, action_type.Impl.GetResultService
        self._goals = self._publisher(self._goal_type, f"{action_name}/_action/send_goal")
        self._results = self._publisher(self._result_type, f"{action_name}/_action/get_result")
        self._sequence = 0

    def tell_goal(self, request: Any) -> None:
        """The request for a goal that is carried out from now on; of None nothing is told."""
        if request is not None:
            info = self._info(ServiceEventInfo.REQUEST_RECEIVED)
            self._goals.publish(self._goal_type.Event(info=info, request=[request]))

    def tell_result(self, handle: ServerGoalHandle, result: Any) -> None:
        """The result of a goal that has ended."""
        request = self._result_type.Request(goal_id=handle.goal_id)
        response = self._result_type.Response(status=handle.status, result=result)
        info = self._info(ServiceEventInfo.RESPONSE_SENT)
        self._results.publish(self._result_type.Event(info=info, request=[request], response=[response]))

    def _info(self, kind: int) -> ServiceEventInfo:
        self._sequence += 1
        stamp = self._node.get_clock().now().to_msg()
        return ServiceEventInfo(event_type=kind, stamp=stamp, sequence_number=self._sequence)

    def _publisher(self, service: Any, name: str) -> Publisher:
        return self._node.create_publisher(service.Event, f"{name}/_service_event", qos.SERVICE_EVENTS)
