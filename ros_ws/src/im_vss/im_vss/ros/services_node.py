"""Base of the nodes of vision processes: the Services there, and their requests."""

import threading
import traceback
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from im_core import plugins
from im_core.errors import ImError
from im_core.ros.calls import run_in_thread
from im_core.ros.node import ManagedNode
from im_vss.catalogue import Catalogue, load_catalogue
from im_vss.rig import Rig
from im_vss.ros.client_liveness import Askers
from im_vss.ros.ports import Port
from im_vss.ros.state import StatePort
from im_vss.vsm import VisionServicesManager

#: How long it may take to write the files of a calibration [s].
FILES_S = 30.0

#: Libraries of the calibration that take seconds to load, and at rest a fifth of the memory of this process.
_CALIBRATION = ("scipy.special", "im_calibration.reporting.plots")


class ServicesNode(ManagedNode):
    """Node of a process of the Vision Services System; the catalogue knows the process by the name of the node.

    Args:
        name: Of the node, unless it is remapped.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        declare = self.declared.declare
        self._files = {
            "settings": declare("settings", "", "file of the Services in use and their settings; empty: the package's"),
            "catalogue": declare("catalogue", "", "file of all Services that exist; empty: the package's"),
        }
        self._vsm: VisionServicesManager | None = None
        self._loads_ahead = False

    def load_services(self, rig: Rig) -> None:
        """Load the Services of the process.

        Raises:
            ImError: The catalogue is wrong, or the software of a Service.
        """
        catalogue: Catalogue = load_catalogue(self._file("catalogue"))
        self._vsm = VisionServicesManager(rig, catalogue, self.get_name())
        self._rig = rig

    def offer_services(self) -> VisionServicesManager:
        """Offer the Services of the process, and its state."""
        assert self._vsm is not None
        for name, entry in self._vsm.catalogue.services.items():
            port = plugins.load(entry.port, Port, "port")(self._rig)
            askers = Askers(self, f"/vss/{name}")
            self.create_service(port.kind, f"/vss/{name}", partial(self._serve, name, port, askers))
        StatePort(self, self._vsm)
        return self._vsm

    def phase_shutdown(self) -> None:
        """End the Vision Modules."""
        if self._vsm is not None:
            self._vsm.close()

    async def _serve(self, name: str, port: Port, askers: Askers, request: Any, response: Any) -> Any:
        """Carry out a request of a Service, in a thread; an error becomes the status."""
        vsm = self._vsm
        assert vsm is not None
        self._load_ahead()
        alive = askers.present()
        remarks: list[str] = []

        def serve() -> None:
            port.answer(vsm.request(name, port.request(request), alive, remarks.append), response)

        try:
            await run_in_thread(self, serve)
        except ImError as error:
            port.refuse(error, response)
        except Exception as error:  # a fault of this program must not end the node
            self.get_logger().error(traceback.format_exc())
            port.refuse(ImError(f"fault in /{self.get_name()}: {error!r}", code="internal"), response)
        else:
            port.succeed(response, list(dict.fromkeys(remarks)))
        return response

    def _load_ahead(self) -> None:
        """Load the needs of a calibration beside the first request: neither the start nor the request has to wait."""
        if not self._loads_ahead and self._vsm is not None and "calibrate" in self._vsm.services:
            self._loads_ahead = True
            threading.Thread(target=lambda: [import_module(name) for name in _CALIBRATION], daemon=True).start()

    def _file(self, parameter: str) -> Path | None:
        value = self._files[parameter]
        return Path(value) if value else None
