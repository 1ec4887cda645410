"""Action servers that have begun anew: they know nothing of the goals that were given to the life before."""

from action_msgs.msg import GoalStatus
from rclpy.action import ActionServer


def forget(monkeypatch, times):
    """The next results that any action server of this process is asked for are of goals that it does not know."""
    answer, left = ActionServer._execute_get_result_request, [None] * times

    async def execute(server, request_header_and_message):
        if left:
            left.pop()
            unknown = server._action_type.Impl.GetResultService.Response(status=GoalStatus.STATUS_UNKNOWN)
            server._handle.send_result_response(request_header_and_message[0], unknown)
        else:
            await answer(server, request_header_and_message)

    monkeypatch.setattr(ActionServer, "_execute_get_result_request", execute)
