"""Every message, service and action that is built here works in a node: nothing that rclpy needs was left out."""

import array
import importlib

import numpy as np
import pytest
from ament_index_python import get_resource
from rosidl_parser import definition as idl

PACKAGES = ("im_msgs", "tf2_msgs", "control_msgs", "controller_manager_msgs")


def interfaces(kind):
    for package in PACKAGES:
        names = get_resource("rosidl_interfaces", package)[0].split()
        for name in sorted(name.partition("/")[2] for name in names if name.endswith(f".{kind}")):
            yield getattr(importlib.import_module(f"{package}.{kind}"), name.removesuffix(f".{kind}"))


def topic(kind):
    return f"/each/{kind.__module__.partition('.')[0]}/{kind.__name__}"


def value(of, number):
    """A value of a type as rosidl describes it, another one for another number."""
    if isinstance(of, idl.NamespacedType):
        return filled(getattr(importlib.import_module(".".join(of.namespaces)), of.name), number)
    if isinstance(of, idl.AbstractGenericString):
        return f"text {number}"
    if isinstance(of, idl.AbstractNestedType):
        size = of.size if isinstance(of, idl.Array) else min(2, getattr(of, "maximum_size", 2))
        return [value(of.value_type, number + i) for i in range(size)]
    if of.typename == "boolean":
        return number % 2 == 1
    if of.typename == "octet":
        return bytes([number % 256])
    return number % 100 / 4 if of.typename in idl.FLOATING_POINT_TYPES else number % 100


def filled(kind, number=1):
    message = kind()
    for name, of in zip(kind.get_fields_and_field_types(), kind.SLOT_TYPES, strict=True):
        number += 1
        given = value(of, number)
        present = getattr(message, name)
        if isinstance(present, np.ndarray):
            given = np.array(given, dtype=present.dtype)
        elif isinstance(present, array.array):
            given = array.array(present.typecode, given)
        setattr(message, name, given)
    return message


def test_a_filled_message_is_no_empty_one():
    for kind in interfaces("msg"):
        if kind.get_fields_and_field_types():
            assert filled(kind) != kind()
            assert filled(kind, 1) != filled(kind, 2)


@pytest.fixture
def node(ros):
    from im_core.ros.guard import GuardedNode

    return ros(GuardedNode("each"))


def test_every_message_makes_the_round_trip(node, wait_until):
    kinds, received = list(interfaces("msg")), {}
    assert {"Firing", "TFMessage", "JointTolerance"} <= {kind.__name__ for kind in kinds}
    publishers = {}
    for kind in kinds:
        node.create_subscription(kind, topic(kind), lambda message, kind=kind: received.update({kind: message}), 10)
        publishers[kind] = node.create_publisher(kind, topic(kind), 10)
    wait_until(lambda: all(p.get_subscription_count() for p in publishers.values()), "the subscriptions")
    for kind in kinds:
        publishers[kind].publish(filled(kind))
    wait_until(lambda: len(received) == len(kinds), "every message")
    for kind in kinds:
        assert received[kind] == filled(kind), kind


def test_every_service_takes_a_request_and_answers(node, wait_until):
    kinds, requests, futures = list(interfaces("srv")), {}, {}
    assert "CalibrateCamera" in {kind.__name__ for kind in kinds}

    def answer(kind, request):
        requests[kind] = request
        return filled(kind.Response, 3)

    for kind in kinds:
        node.create_service(kind, topic(kind), lambda request, _, kind=kind: answer(kind, request))
        client = node.create_client(kind, topic(kind))
        assert client.wait_for_service(60.0), kind
        futures[kind] = client.call_async(filled(kind.Request))
    wait_until(lambda: all(future.done() for future in futures.values()), "every answer")
    for kind in kinds:
        assert requests[kind] == filled(kind.Request), kind
        assert futures[kind].result() == filled(kind.Response, 3), kind


def test_every_action_takes_a_goal_and_gives_feedback_and_a_result(node, wait_until):
    from rclpy.action import ActionServer

    from im_core.ros.guard import GuardedActionClient

    for kind in interfaces("action"):
        goals, feedbacks = [], []

        def execute(handle, kind=kind, goals=goals):
            goals.append(handle.request)
            handle.publish_feedback(filled(kind.Feedback, 3))
            handle.succeed()
            return filled(kind.Result, 5)

        server = ActionServer(node, kind, topic(kind), execute)
        client = GuardedActionClient(node, kind, topic(kind))
        assert client.wait_for_server(60.0), kind
        sent = client.send_goal_async(
            filled(kind.Goal), feedback_callback=lambda message, into=feedbacks: into.append(message.feedback)
        )
        wait_until(sent.done, "the goal to be taken")
        result = sent.result().get_result_async()
        wait_until(lambda result=result, feedbacks=feedbacks: result.done() and feedbacks, "result and feedback")
        assert (goals, feedbacks) == ([filled(kind.Goal)], [filled(kind.Feedback, 3)])
        assert result.result().result == filled(kind.Result, 5)
        client.destroy()
        server.destroy()
