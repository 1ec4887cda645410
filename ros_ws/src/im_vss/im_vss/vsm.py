"""The Vision Services Manager: the central point of access to the Vision Services System (paper, section 5)."""

import itertools
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from im_core import plugins
from im_core.errors import NotFoundError
from im_vss.catalogue import PROCESS, Catalogue
from im_vss.managers import ModuleState, VisionClient, VisionModuleManager
from im_vss.modules import VisionModule
from im_vss.rig import Rig
from im_vss.services import VisionService
from im_vss.tools import ModuleAccess, Tool


@dataclass(frozen=True)
class VisionState:
    """Loaded parts, queues and owners of VSS.

    Attributes:
        services: Names of the Services in use.
        tools: Names of the Tools loaded for them.
        requests: Names of the requests under way, oldest first.
        modules: By name of each Vision Module, its manager and who uses it.
    """

    services: tuple[str, ...]
    tools: tuple[str, ...]
    requests: tuple[str, ...]
    modules: dict[str, tuple[str, ModuleState]]


class VisionServicesManager:
    """Manager of Services: loads the parts of the Services in use, and routes requests to Services by name.

    Attributes:
        in_use: The part of the catalogue in use, in all processes.
        catalogue: The part of it in this process.
    """

    def __init__(self, rig: Rig, catalogue: Catalogue, process: str = PROCESS) -> None:
        """Load the closure of the Services in use.

        Args:
            rig: Settings, which list the Services in use, and hardware.
            catalogue: All that exists.
            process: Name of this process in the catalogue; Services of others are theirs.

        Raises:
            ImError: A Service does not exist, or its software cannot be loaded.
        """
        self.in_use = catalogue.closure(rig.settings.services)
        self.catalogue = closure = self.in_use.in_process(process)
        self.modules: dict[str, VisionModule] = {
            name: plugins.load(entry.implementation, VisionModule, "vision module")(rig)
            for name, entry in closure.modules.items()
        }
        self.managers: dict[str, VisionModuleManager] = {
            manager: VisionModuleManager(
                manager,
                {
                    name: rig.settings.waits.solve if self.modules[name].computes else rig.settings.waits.hold
                    for name, entry in closure.modules.items()
                    if entry.manager == manager
                },
                wait_s=rig.settings.waits.lease,
            )
            for manager in closure.managers
        }
        self.tools: dict[str, Tool] = {
            name: plugins.load(entry.implementation, Tool, "tool")(rig, self._access(entry.modules))
            for name, entry in closure.tools.items()
        }
        self.services: dict[str, VisionService] = {
            name: plugins.load(entry.implementation, VisionService, "vision service")(
                rig, {tool: self.tools[tool] for tool in entry.tools}
            )
            for name, entry in closure.services.items()
        }
        self._numbers = itertools.count(1)
        self._clients: dict[str, VisionClient] = {}
        self._lock = threading.Lock()

    def request(
        self,
        service: str,
        request: Any,
        alive: Callable[[], bool] = lambda: True,
        tell: Callable[[str], None] = lambda remark: None,
    ) -> Any:
        """Carry out a request by a Service; block until the end, from any number of threads.

        Args:
            service: Name of the Service.
            request: The Service's own request type.
            alive: Whether whoever asked still waits for the answer.
            tell: Is told what whoever asked must know beside the answer, a clause; maybe several times.

        Raises:
            NotFoundError: The Service is not loaded.
            StateError: The request was cancelled.
            ImError: As raised by the Service.
        """
        if service not in self.services:
            raise NotFoundError(kind="vision service", name=service, known=self.services)
        client = VisionClient(f"{service} #{next(self._numbers)}", alive, tell)
        with self._lock:
            self._clients[client.name] = client
        try:
            result = self.services[service].serve(client, request)
            client.check()
            return result
        finally:
            with self._lock:
                del self._clients[client.name]

    def cancel(self, request: str) -> None:
        """Give up a request: the waits and leases end, and the client gets a :class:`StateError`.

        Args:
            request: Its name, as in :meth:`state`.

        Raises:
            NotFoundError: No such request is under way.
            StateError: It changes something already.
        """
        with self._lock:
            if request not in self._clients:
                raise NotFoundError(kind="request under way", name=request, known=self._clients)
            self._clients[request].cancel()

    def state(self) -> VisionState:
        """Return loaded parts, waiting clients and owners."""
        with self._lock:
            requests = tuple(self._clients)
        return VisionState(
            services=tuple(self.services),
            tools=tuple(self.tools),
            requests=requests,
            modules={
                name: (entry.manager, self.managers[entry.manager].state(name))
                for name, entry in self.catalogue.modules.items()
            },
        )

    def close(self) -> None:
        """End the Vision Modules' threads."""
        for module in self.modules.values():
            module.close()

    def _access(self, names: tuple[str, ...]) -> ModuleAccess:
        return ModuleAccess(
            {name: (self.managers[self.catalogue.modules[name].manager], self.modules[name]) for name in names}
        )
