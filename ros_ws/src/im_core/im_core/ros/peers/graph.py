"""Changes of the ROS graph as events: rclpy has none, so the C library of rclpy is asked to wait.

``rcl_node_get_graph_guard_condition`` gives what the middleware triggers whenever a node, publisher, subscription,
service or client comes or goes anywhere in the domain.
"""

import ctypes
import threading
from collections.abc import Callable
from typing import Any

from rclpy.node import Node

from im_core.errors import LinkError

_OK, _TIMEOUT = 0, 2
_END_AFTER_NS = 200_000_000


class _Allocator(ctypes.Structure):
    """``rcutils_allocator_t``: four functions and a state."""

    _fields_ = [(name, ctypes.c_void_p) for name in ("allocate", "free", "realloc", "zero", "state")]


class _WaitSet(ctypes.Structure):
    """``rcl_wait_set_t``: arrays of six kinds with sizes, and the implementation."""

    _fields_ = [(name, ctypes.c_void_p) for name in "abcdefghijklm"]


def _libraries() -> tuple[ctypes.CDLL, ctypes.CDLL]:
    rcl, rcutils = ctypes.CDLL("librcl.so"), ctypes.CDLL("librcutils.so")
    rcutils.rcutils_get_default_allocator.restype = _Allocator
    rcl.rcl_get_zero_initialized_wait_set.restype = _WaitSet
    rcl.rcl_node_get_graph_guard_condition.restype = ctypes.c_void_p
    rcl.rcl_node_get_graph_guard_condition.argtypes = [ctypes.c_void_p]
    sizes = [ctypes.c_size_t] * 6
    rcl.rcl_wait_set_init.argtypes = [ctypes.POINTER(_WaitSet), *sizes, ctypes.c_void_p, _Allocator]
    rcl.rcl_wait_set_clear.argtypes = [ctypes.POINTER(_WaitSet)]
    rcl.rcl_wait_set_fini.argtypes = [ctypes.POINTER(_WaitSet)]
    rcl.rcl_wait_set_add_guard_condition.argtypes = [ctypes.POINTER(_WaitSet), ctypes.c_void_p, ctypes.c_void_p]
    rcl.rcl_wait.argtypes = [ctypes.POINTER(_WaitSet), ctypes.c_int64]
    return rcl, rcutils


class GraphWatch:
    """Call a function, in a separate thread, after each change of the graph and once at the start.

    Args:
        node: A node that exists longer than this.
        changed: It; must be short.

    Raises:
        LinkError: ROS gives no wait set.
    """

    def __init__(self, node: Node, changed: Callable[[], None]) -> None:
        self._node, self._changed = node, changed
        self._rcl, rcutils = _libraries()
        self._set = self._rcl.rcl_get_zero_initialized_wait_set()
        context: Any = node.context.handle
        handle = node.handle
        with context, handle:
            self._condition = self._rcl.rcl_node_get_graph_guard_condition(handle.pointer)
            self._check(
                self._rcl.rcl_wait_set_init(
                    ctypes.byref(self._set), 0, 1, 0, 0, 0, 0, context.pointer, rcutils.rcutils_get_default_allocator()
                )
            )
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="graph", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the watching; before the node is destroyed."""
        self._end.set()
        self._thread.join()
        self._rcl.rcl_wait_set_fini(ctypes.byref(self._set))

    def _watch(self) -> None:
        own = ctypes.byref(self._set)
        self._changed()
        while not self._end.is_set():
            self._check(self._rcl.rcl_wait_set_clear(own))
            self._check(self._rcl.rcl_wait_set_add_guard_condition(own, self._condition, None))
            code = self._rcl.rcl_wait(own, _END_AFTER_NS)
            if code == _OK:
                self._changed()
            elif code != _TIMEOUT:
                return  # ROS was shut down

    @staticmethod
    def _check(code: int) -> None:
        if code != _OK:
            raise LinkError(f"ROS cannot wait for changes of its graph: code {code} of rcl")
