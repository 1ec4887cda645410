"""Deletion of the data objects of ended commands, also of commands which ended in a death of the node."""

import re
from collections.abc import Callable, Container

from im_core.errors import ImError
from im_core.ros.calls import pause
from im_core.ros.dom import DomClient
from im_core.ros.node import ManagedNode

LOOK_S = 0.5
"""How often a node that begins looks whether ``/dom`` is there; nobody waits for it [s]."""


class CommandScopes:
    """Owner of the data objects of commands: ``/dom`` deletes objects after the end of a command, except results."""

    def __init__(self, node: ManagedNode, dom: DomClient, open_scopes: Callable[[], Container[str]]) -> None:
        self._node, self._dom, self._open_scopes = node, dom, open_scopes
        self._scope = re.compile(rf"({re.escape(node.task_name)}/\d+-\d+-\d+)/.+")
        self._wanted = self._running = False

    def tidy(self) -> None:
        """Delete the remaining objects of ended commands, soon."""
        self._wanted = True
        if not self._running and self._dom.is_there():
            self._running = True
            self._node.spawn(self._tidy())

    async def begin(self) -> None:
        """Delete the objects of commands of former incarnations, once ``/dom`` is there."""
        while not self._dom.is_there():
            await pause(self._node, LOOK_S)
        self.tidy()

    async def _tidy(self) -> None:
        try:
            while self._wanted:
                self._wanted = False
                names = await self._dom.names(f"{self._node.task_name}/")
                found = dict.fromkeys(match[1] for name in names if (match := self._scope.fullmatch(name)))
                for scope in found:
                    if scope not in self._open_scopes():
                        await self._dom.forget(f"{scope}/")
        except ImError as error:
            self._node.get_logger().warning(f"objects of commands that have ended are still in /dom: {error.message}")
        finally:
            self._running = False
