"""Open commands of a node in a file, for the next start after the death of the machine."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from im_core.errors import ImError
from im_core.ros.calls import run_in_thread
from im_core.ros.coroutines import Promise
from im_core.ros.node import ManagedNode
from im_core.unfinished_commands import OpenCommandNote, note


class CommandNotes:
    """Writer of the open commands of a node, soon after a change; the work is in the journal.

    Args:
        node: The node.
        run_dir: Folder of the machine; None: nothing is written.
        commands: Returns the commands that have not ended.
    """

    def __init__(
        self, node: ManagedNode, run_dir: Path | None, commands: Callable[[], Sequence[OpenCommandNote]]
    ) -> None:
        self._node, self._run_dir, self._commands = node, run_dir, commands
        self._wanted = self._running = False
        self._waiting: list[Promise] = []

    def changed(self) -> None:
        """Write the open commands, soon."""
        self._wanted = True
        if not self._running and self._run_dir is not None:
            self._running = True
            self._node.spawn(self._write(self._run_dir))

    def write_last(self) -> None:
        """Write the notes at once, as the node ends, to show the progress of the commands after a stop."""
        if self._run_dir is not None:
            with suppress(ImError):  # it is known which they are
                note(self._run_dir, self._node.task_name, self._commands())

    async def written(self) -> None:
        """Wait until the present open commands are written, or cannot be."""
        if self._run_dir is not None:
            promise = self._node.promise()
            self._waiting.append(promise)
            self.changed()
            await promise

    async def _write(self, run_dir: Path) -> None:
        task = self._node.task_name
        try:
            while self._wanted:
                self._wanted = False
                waiting, self._waiting = self._waiting, []
                try:
                    await run_in_thread(self._node, note, run_dir, task, self._commands())
                except ImError as error:
                    self._node.get_logger().warning(f"which commands are open is not written down: {error.message}")
                finally:
                    for promise in waiting:
                        promise.set_result(None)
        finally:
            self._running = False
