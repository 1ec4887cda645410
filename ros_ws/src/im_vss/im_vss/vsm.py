"""The Vision Services Manager: the central point of access to the Vision Services System (paper, section 5)."""

import itertools
from collections.abc import Callable
from typing import Any

from im_core.errors import NotFoundError
from im_vss.catalogue import Catalogue, load_class
from im_vss.managers import VisionClient, VisionModuleManager
from im_vss.modules import VisionModule
from im_vss.rig import Rig
from im_vss.services import Service
from im_vss.tools import ModuleAccess, Tool


class VisionServicesManager:
    """Loads what the Services in use need, and routes requests to them by name."""

    def __init__(self, rig: Rig, catalogue: Catalogue) -> None:
        """Load the closure of the Services in use.

        Args:
            rig: Settings, which list the Services in use, and hardware.
            catalogue: All that exists.

        Raises:
            ImError: A Service does not exist, or its software cannot be loaded.
        """
        self.catalogue = closure = catalogue.closure(rig.settings.services)
        self.modules: dict[str, VisionModule] = {
            name: load_class(entry.implementation, VisionModule)(rig) for name, entry in closure.modules.items()
        }
        self.managers: dict[str, VisionModuleManager] = {
            manager: VisionModuleManager(
                manager,
                [name for name, entry in closure.modules.items() if entry.manager == manager],
                wait_s=rig.settings.waits.lease,
                hold_s=rig.settings.waits.hold,
            )
            for manager in closure.managers
        }
        self.tools: dict[str, Tool] = {
            name: load_class(entry.implementation, Tool)(rig, self._access(entry.modules))
            for name, entry in closure.tools.items()
        }
        self.services: dict[str, Service] = {
            name: load_class(entry.implementation, Service)(rig, {tool: self.tools[tool] for tool in entry.tools})
            for name, entry in closure.services.items()
        }
        self._numbers = itertools.count(1)

    def request(self, service: str, request: Any, alive: Callable[[], bool] = lambda: True) -> Any:
        """Have a Service carry out a request; blocks until it has, from any number of threads.

        Args:
            service: Name of the Service.
            request: The Service's own request type.
            alive: Whether whoever asked still waits for the answer.

        Raises:
            NotFoundError: The Service is not loaded.
            ImError: As raised by the Service.
        """
        if service not in self.services:
            raise NotFoundError(kind="vision service", name=service, known=self.services)
        client = VisionClient(f"{service} #{next(self._numbers)}", alive)
        return self.services[service].serve(client, request)

    def close(self) -> None:
        """End the Vision Modules' threads."""
        for module in self.modules.values():
            module.close()

    def _access(self, names: tuple[str, ...]) -> ModuleAccess:
        return ModuleAccess(
            {name: (self.managers[self.catalogue.modules[name].manager], self.modules[name]) for name in names}
        )
