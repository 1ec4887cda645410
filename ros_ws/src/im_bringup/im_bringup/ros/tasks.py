"""``im tasks``: the tasks of the running machine, with place, progress and load (paper, section 3)."""

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray

from im_bringup.ros.bootstrap import LOADS_TOPIC
from im_bringup.ros.client_output import DONE
from im_bringup.ros.interruptible import InterruptibleNode, talk
from im_core.errors import NotFoundError
from im_core.options import NumberParser, seconds
from im_core.ros import qos
from im_msgs.msg import TaskRecord, TaskRegistry

#: How long the bootstrap is awaited at first [s].
WAIT_S = 10.0
_COLUMNS = {
    "id": "id",
    "task": "name",
    "state": "phase",
    "host": "host",
    "process": "process",
    "pid": "pid",
    "restarts": "restarts",
    "calls/s": "callbacks_per_s",
    "open": "open_requests",
    "oldest s": "oldest_request_s",
    "refused": "refused_requests",
    "CPU": "process_cpu",
    "MiB": "process_memory_mib",
}


class TasksNode(InterruptibleNode):
    """Client that reads the registry and the loads of the tasks."""

    def __init__(self) -> None:
        super().__init__("tasks")
        self._registry: TaskRegistry | None = None
        self._loads: dict[str, dict[str, float]] | None = None
        self.create_subscription(TaskRegistry, "/bootstrap/tasks", self._register, qos.LATCHED)
        self.create_subscription(DiagnosticArray, LOADS_TOPIC, self._load, qos.LATCHED)

    def read(self, timeout_s: float) -> list[dict[str, Any]]:
        """Return all tasks: fields of ``im_msgs/msg/TaskRecord``, and the load.

        Args:
            timeout_s: Longest wait for the bootstrap [s].

        Raises:
            KeyboardInterrupt: Somebody interrupted.
            WaitTimeoutError: The bootstrap told nothing in time.
        """
        self._until(
            lambda: self._registry is not None and self._loads is not None,
            f"the tasks on /bootstrap/tasks and {LOADS_TOPIC}",
            timeout_s,
        )
        registry, loads = self._registry or TaskRegistry(), self._loads or {}
        return [as_dict(task) | loads.get(task.name, {}) for task in registry.tasks]

    def _register(self, message: TaskRegistry) -> None:
        self._registry = message

    def _load(self, message: DiagnosticArray) -> None:
        self._loads = {
            status.name.removeprefix("tasks: "): {value.key: float(value.value) for value in status.values}
            for status in message.status
        }


def as_dict(task: TaskRecord) -> dict[str, Any]:
    """Return the fields of a task by name."""
    return {name: getattr(task, name) for name in task.get_fields_and_field_types()}


def table(tasks: Sequence[Mapping[str, Any]]) -> str:
    """Return tasks as a table, a line each; why one has failed stands below its line."""
    rows = [list(_COLUMNS), *([_cell(task.get(key, "")) for key in _COLUMNS.values()] for task in tasks)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(_COLUMNS))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    for rank, task in reversed(list(enumerate(tasks, start=1))):
        if task["detail"]:
            lines.insert(rank + 1, f"    {task['detail']}")
    return "\n".join(lines)


def details(task: Mapping[str, Any]) -> str:
    """Return all that is known of a task, a line for each field."""
    return "\n".join(f"{key}: {_cell(value)}" for key, value in task.items())


def chosen(tasks: Sequence[dict[str, Any]], text: str) -> dict[str, Any]:
    """Return the task with a name or an id.

    Raises:
        NotFoundError: There is none; names those that exist.
    """
    for task in tasks:
        if text in (task["name"], str(task["id"]), task["node"]):
            return task
    raise NotFoundError(kind="task", name=text, known=[task["name"] for task in tasks])


def _cell(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _show(node: TasksNode, options: argparse.Namespace) -> int:
    tasks = node.read(options.timeout)
    if options.task:
        tasks = [chosen(tasks, options.task)]
    if options.json:
        print(json.dumps(tasks, indent=2))
    else:
        print(details(tasks[0]) if options.task else table(tasks))
    return DONE


def main() -> int:
    """Run the command."""
    parser = NumberParser(
        prog="im tasks",
        description="Show the tasks of the running machine: where each runs, how far it is, and its load. CPU and "
        "memory are those of a task's process with its children: tasks of one process share them. CPU 1 is one "
        "processor.",
        epilog="Example: im tasks dispatcher . Exit codes: 0 done, 1 there is no such task, 2 bad usage, 3 no machine "
        "runs here or its bootstrap does not answer, 130 interrupted.",
    )
    parser.add_argument("task", nargs="?", help="name, id or node of a task: show everything about it")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument(
        "--timeout",
        type=seconds,
        default=WAIT_S,
        metavar="S",
        help="longest wait for the bootstrap [s] (default: %(default)g)",
    )
    options = parser.parse_args()
    return talk(TasksNode, lambda node: _show(node, options), "im tasks")


if __name__ == "__main__":
    sys.exit(main())
