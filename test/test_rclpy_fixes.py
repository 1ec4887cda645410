"""The faults of rclpy are still there: a test that fails here says which module of im_core/ros/rclpy_fixes may go."""

import subprocess
import sys

import pytest
import rclpy
from rclpy.action import ActionServer
from rclpy.clock import Clock, ClockType
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from std_msgs.msg import String

from im_core import clock

RESETS = 50


@pytest.fixture
def bare():
    """A node of rclpy alone, its executor, and a function that turns the loop."""
    context = rclpy.Context()
    rclpy.init(context=context)
    node, executor = Node("bare", context=context), EventsExecutor(context=context)
    executor.add_node(node)

    def turn(enough):
        deadline = clock.monotonic() + 60.0
        while not enough():
            assert clock.monotonic() < deadline, f"{enough} did not become true"
            executor.spin_once(timeout_sec=0.05)

    yield node, turn
    executor.shutdown()
    node.destroy_node()
    rclpy.try_shutdown(context=context)


def test_rclpy_still_strikes_a_timer_once_for_each_reset(bare):
    node, turn = bare
    steady, strikes, woken = Clock(clock_type=ClockType.STEADY_TIME), [], []
    slow = node.create_timer(0.2, lambda: strikes.append(None), clock=steady)
    other = node.create_timer(0.001, lambda: (woken.append(None), other.cancel()), clock=steady)
    turn(lambda: woken)

    def be_late():
        clock.sleep(0.3)  # the slow timer is due
        for _ in range(RESETS):
            other.reset()
            clock.sleep(0.002)

    node.executor.create_task(be_late)
    woken.clear()
    turn(lambda: woken)
    turn(lambda: slow.time_until_next_call() > 5 * slow.timer_period_ns)


def test_rclpy_still_introspects_no_actions():
    assert not hasattr(ActionServer, "configure_introspection")


def test_rclpy_still_decodes_a_message_once_for_each_subscription(bare):
    node, turn = bare
    heard = []
    for _ in range(2):
        node.create_subscription(String, "/bare/said", heard.append, 10)
    publisher = node.create_publisher(String, "/bare/said", 10)
    turn(lambda: publisher.get_subscription_count() == 2)
    publisher.publish(String(data="said"))
    turn(lambda: len(heard) == 2)
    assert heard[0] is not heard[1]


def test_a_destruction_that_hangs_ends_the_process():
    """In C, and with the interpreter's lock, so that neither a signal nor a thread of Python comes in."""
    code = """
import ctypes
from im_core.ros.rclpy_fixes import bounded_end
bounded_end.LONGEST_S = 0.5
with bounded_end.bounded_end():
    pass
with bounded_end.bounded_end():
    ctypes.PyDLL(None).sleep(600)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300.0, check=False)
    assert (done.returncode, done.stdout) == (1, "")
    assert 'File "<string>", line 8 in <module>' in done.stderr
