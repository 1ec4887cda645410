"""The master catalogue of all Services, Tools and Vision Modules, and the part needed by an application."""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from im_core.config import Model, load_model, package_file
from im_core.errors import NotFoundError

PROCESS = "vss"
"""Name of the process of the cameras, the monitors and the laser scanner, and of its node."""
_OF_CAMERAS = ("image_processing", "laser_scanner")
"""Managers of Vision Modules in that process."""

Implementation = Annotated[str, Field(pattern=r"^[a-z_][\w.]*:[A-Z]\w*$")]


class ServiceEntry(Model):
    """A Service.

    Attributes:
        implementation: Its class as ``module:Class``.
        port: The class that carries its messages, as ``module:Class``; only the node loads it.
        tools: The Tools it calls.
        process: Process that runs it, of those in `processes`.
    """

    implementation: Implementation
    port: Implementation
    tools: tuple[str, ...]
    process: str


class ProcessEntry(Model):
    """Process of the Vision Services System, on a host; its node has the name of the process."""

    host: str


class ToolEntry(Model):
    """Tool of the catalogue: the class as ``module:Class``, and the Vision Modules."""

    implementation: Implementation
    modules: tuple[str, ...]


class ModuleEntry(Model):
    """Vision Module of the catalogue: the class as ``module:Class``, and the manager."""

    implementation: Implementation
    manager: str


class Catalogue(Model):
    """The whole catalogue; ``managers`` gives the purpose of each Vision Module Manager.

    A Vision Module owns its hardware, so all Services that use it, directly or through a Tool, run in one process.
    """

    services: dict[str, ServiceEntry]
    tools: dict[str, ToolEntry]
    modules: dict[str, ModuleEntry]
    managers: dict[str, str]
    processes: dict[Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")], ProcessEntry]

    @model_validator(mode="after")
    def _references(self) -> Self:
        for name, service in self.services.items():
            _require(f"services.{name}.tools", service.tools, self.tools)
            _require(f"services.{name}.process", [service.process], self.processes)
        for name, tool in self.tools.items():
            _require(f"tools.{name}.modules", tool.modules, self.modules)
        for name, module in self.modules.items():
            _require(f"modules.{name}.manager", [module.manager], self.managers)
        owners: dict[str, str] = {}
        for name, service in self.services.items():
            for used in (used for tool in service.tools for used in self.tools[tool].modules):
                if service.process != PROCESS and (manager := self.modules[used].manager) in _OF_CAMERAS:
                    raise ValueError(
                        f"services.{name}.process: '{service.process}' uses {used} of the {manager}, which is in "
                        f"'{PROCESS}' with the cameras"
                    )
                if owners.setdefault(used, service.process) != service.process:
                    raise ValueError(
                        f"services.{name}.process: '{service.process}' uses {used}, which '{owners[used]}' owns"
                    )
        return self

    def closure(self, services: Iterable[str]) -> Self:
        """Return the part needed by some Services, directly or through the Tools.

        Raises:
            NotFoundError: There is no Service of one of the names.
        """
        chosen: dict[str, ServiceEntry] = {}
        for name in services:
            if name not in self.services:
                raise NotFoundError(kind="vision service", name=name, known=self.services)
            chosen[name] = self.services[name]
        used_tools = {name for service in chosen.values() for name in service.tools}
        tools = {name: tool for name, tool in self.tools.items() if name in used_tools}
        used_modules = {name for tool in tools.values() for name in tool.modules}
        modules = {name: module for name, module in self.modules.items() if name in used_modules}
        used_managers = {module.manager for module in modules.values()}
        managers = {name: purpose for name, purpose in self.managers.items() if name in used_managers}
        used_processes = {service.process for service in chosen.values()}
        processes = {name: process for name, process in self.processes.items() if name in used_processes}
        return self.model_copy(
            update={
                "services": chosen,
                "tools": tools,
                "modules": modules,
                "managers": managers,
                "processes": processes,
            }
        )

    def in_process(self, process: str) -> Self:
        """Return the part of one process.

        Raises:
            NotFoundError: There is no such process.
        """
        if process not in self.processes:
            raise NotFoundError(kind="process of the vision services", name=process, known=self.processes)
        return self.closure(name for name, service in self.services.items() if service.process == process)

    def deployment(self, path: Path | None = None) -> dict[str, Any]:
        """Return the ``hosts`` of a deployment file for the Services: host -> process -> task.

        Args:
            path: The file of the catalogue; None: the shipped one.
        """
        hosts: dict[str, Any] = {}
        given = {} if path is None else {"catalogue": str(path.resolve())}
        for name, process in self.processes.items():
            task = {"package": "im_vss", "executable": "vss_apart", "node": f"/{name}", "needs": ["cameras"]}
            parameters: dict[str, str] = dict(given)
            if name == PROCESS:
                task["executable"] = "vss"
                parameters["calibration"] = "${calibration}"
            hosts.setdefault(process.host, {})[name] = {name: {**task, "parameters": parameters}}
        return hosts


def load_catalogue(path: Path | None = None) -> Catalogue:
    """Read a catalogue; the shipped one by default.

    Raises:
        ConfigError: The file is missing or wrong; the message names file and line.
    """
    return load_model(path or package_file("im_vss", "config/catalogue.yaml"), Catalogue)


def _require(where: str, names: Iterable[str], known: Iterable[str]) -> None:
    for name in names:
        if name not in known:
            raise ValueError(f"{where}: '{name}' is not one of {', '.join(sorted(known))}")
