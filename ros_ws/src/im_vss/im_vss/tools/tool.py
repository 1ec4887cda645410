"""Base of all Tools."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, ClassVar

from im_core.errors import ConfigError
from im_vss.managers import Lease, VisionClient, VisionModuleManager
from im_vss.modules import VisionModule
from im_vss.rig import Rig


class ModuleAccess:
    """Way of a Tool to the Vision Modules, through the managers."""

    def __init__(self, routes: Mapping[str, tuple[VisionModuleManager, VisionModule]]) -> None:
        """Give access to some modules, each with the manager."""
        self._routes = dict(routes)

    @contextmanager
    def use(self, name: str, client: VisionClient) -> Iterator[tuple[Any, Lease]]:
        """Borrow a module for a ``with`` block.

        Raises:
            ConfigError: The catalogue does not list the module for this Tool.
            ImError: See :meth:`VisionModuleManager.lend`.
        """
        if name not in self._routes:
            raise ConfigError(f"a tool may use {sorted(self._routes)}, not {name}; see its line in the catalogue")
        manager, module = self._routes[name]
        with manager.lend(name, client) as lease:
            yield module, lease


class Tool:
    """A step of a Service."""

    name: ClassVar[str]

    def __init__(self, rig: Rig, modules: ModuleAccess) -> None:
        """Work on `rig`, through `modules`."""
        self.rig = rig
        self.modules = modules
