"""``im action``: actions of the graph, and goals for one."""

import argparse
import math
import sys
from collections.abc import Callable

from action_msgs.msg import GoalStatus

from im_bringup.ros.client_output import DONE, FAILED
from im_bringup.ros.graph.client import GraphClient, GraphParser, class_of, message_from, message_text, print_all
from im_core import clock
from im_core.errors import StateError
from im_core.ros.guard import GuardedActionClient
from im_core.ros.peers.servers import node_of, servers_of

#: A server that is away for so long is gone, and so is the result of its goal [s].
_GONE_S = 3.0
_STATES = {
    GoalStatus.STATUS_SUCCEEDED: "SUCCEEDED",
    GoalStatus.STATUS_CANCELED: "CANCELED",
    GoalStatus.STATUS_ABORTED: "ABORTED",
}


def parser() -> GraphParser:
    """The arguments of the command."""
    example = "im action send_goal /dispatcher/execute im_msgs/action/ExecuteCommand '{symbol: home}'"
    found = GraphParser("action", "Show the actions of the ROS graph, send a goal; Ctrl-C cancels it.", example)
    found.list_verb()
    found.verb("type", _type, "print the type of an action", "action_name")
    found.verb("info", _info, "print the servers and clients of an action", "action_name")
    send = found.verb("send_goal", _send_goal, "send a goal, and wait for its result", "action_name", "action_type")
    send.add_argument("goal", nargs="?", default="{}", help="fields of the goal as YAML")
    send.add_argument("-f", "--feedback", action="store_true", help="print the feedback, too")
    return found


def _type(node: GraphClient, options: argparse.Namespace) -> int:
    return print_all([node.find("action", options.action_name, options.timeout)])


def _info(node: GraphClient, options: argparse.Namespace) -> int:
    name = options.action_name
    print(f"Action: {name} [{node.find('action', name, options.timeout)}]")
    status = f"{name}/_action/status"
    for title, ends in (
        ("clients", node.get_subscriptions_info_by_topic(status)),
        ("servers", node.get_publishers_info_by_topic(status)),
    ):
        print(f"Action {title}: {len(ends)}")
        for end in ends:
            print(f"    {node_of(end)}")
    return DONE


def _send_goal(node: GraphClient, options: argparse.Namespace) -> int:
    name, type_name = options.action_name, options.action_type
    kind = class_of(type_name)
    goal = message_from(kind.Goal(), options.goal, type_name)
    node.require("action", name, type_name, options.timeout)
    client = GuardedActionClient(node, kind, name)
    node.wait(client.server_is_ready, f"a server of {name}", options.timeout)
    feedback = (lambda message: print(f"Feedback:\n{message_text(message.feedback)}")) if options.feedback else None
    sent = client.send_goal_async(goal, feedback_callback=feedback)
    node.wait(sent.done, f"an answer of {name}", options.timeout)
    handle = sent.result()
    if not handle.accepted:
        raise StateError("the goal was rejected")
    print(f"Goal accepted with ID: {bytes(handle.goal_id.uuid).hex()}\n", flush=True)
    result = handle.get_result_async()
    try:
        node.wait(_ended(node, result.done, name), f"the result of {name}", math.inf)
    except KeyboardInterrupt:
        node.go_on()
        print("Canceling goal...", flush=True)
        handle.cancel_goal_async()
        node.wait(result.done, f"the end of the goal of {name}", options.timeout)
    answer = result.result()
    print(f"Result:\n{message_text(answer.result)}")
    print(f"Goal finished with status: {_STATES.get(answer.status, 'UNKNOWN')}")
    return DONE if answer.status == GoalStatus.STATUS_SUCCEEDED else FAILED


def _ended(node: GraphClient, done: Callable[[], bool], name: str) -> Callable[[], bool]:
    """Return the look for the end of a goal; the look raises StateError where the server is gone."""
    served = clock.monotonic()

    def look() -> bool:
        nonlocal served
        if done():
            return True
        if servers_of(node, name):
            served = clock.monotonic()
        elif clock.monotonic() - served > _GONE_S:
            raise StateError(f"the server of {name} is gone; the end of the goal is unknown")
        return False

    return look


def main() -> int:
    """Run the command."""
    return parser().run()


if __name__ == "__main__":
    sys.exit(main())
