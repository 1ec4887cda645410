"""Publish the goals, results and cancellations of actions as events on topics.

- Upstream: rclpy of Jazzy introspects services only; actions follow in Kilted.
- Issue: https://github.com/ros2/rclpy/pull/1413.
- Seen: rclpy 7.1.6 (Jazzy).
- Test: ``test_rclpy_still_introspects_no_actions`` in
  ``test/test_rclpy_fixes.py`` fails once upstream has mended it.
"""

from typing import Any

from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from rclpy.publisher import Publisher
from service_msgs.msg import ServiceEventInfo

from im_core.ros import qos


class ActionEvents:
    """Publish the contents of one action: goals, results, and cancel requests.

    The topics are ``<action>/_action/send_goal/_service_event``, ``.../get_result/...`` and ``.../cancel_goal/...``.
    """

    def __init__(self, node: Node, action_type: Any, action_name: str) -> None:
        self._node = node
        self._goal_type, self._result_type = action_type.Impl.SendGoalService, action_type.Impl.GetResultService
        self._cancel_type = action_type.Impl.CancelGoalService
        self._goals = self._publisher(self._goal_type, f"{action_name}/_action/send_goal")
        self._results = self._publisher(self._result_type, f"{action_name}/_action/get_result")
        self._cancels = self._publisher(self._cancel_type, f"{action_name}/_action/cancel_goal")
        self._sequence = 0

    def tell_goal(self, handle: ServerGoalHandle) -> None:
        """Publish the request for a goal carried out from now on."""
        request = self._goal_type.Request(goal_id=handle.goal_id, goal=handle.request)
        info = self._info(ServiceEventInfo.REQUEST_RECEIVED)
        self._goals.publish(self._goal_type.Event(info=info, request=[request]))

    def tell_result(self, handle: ServerGoalHandle, result: Any) -> None:
        """Publish the result of an ended goal."""
        request = self._result_type.Request(goal_id=handle.goal_id)
        response = self._result_type.Response(status=handle.status, result=result)
        info = self._info(ServiceEventInfo.RESPONSE_SENT)
        self._results.publish(self._result_type.Event(info=info, request=[request], response=[response]))

    def tell_cancel(self, request: Any) -> None:
        """Publish the request to cancel goals; the results tell the outcome."""
        info = self._info(ServiceEventInfo.REQUEST_RECEIVED)
        self._cancels.publish(self._cancel_type.Event(info=info, request=[request]))

    def _info(self, kind: int) -> ServiceEventInfo:
        self._sequence += 1
        stamp = self._node.get_clock().now().to_msg()
        return ServiceEventInfo(event_type=kind, stamp=stamp, sequence_number=self._sequence)

    def _publisher(self, service: Any, name: str) -> Publisher:
        return self._node.create_publisher(service.Event, f"{name}/_service_event", qos.SERVICE_EVENTS)
