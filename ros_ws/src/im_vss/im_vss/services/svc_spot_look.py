"""Service that exposes cameras for the light spot, and leaves the search to go on."""

import threading
from concurrent.futures import Future
from dataclasses import dataclass
from typing import ClassVar

from im_core.stopwatch import Stopwatch
from im_vss.looks import Look
from im_vss.managers import VisionClient
from im_vss.services.service import VisionService
from im_vss.services.svc_spot_find import SpotFindResult, find_in_pairs


@dataclass(frozen=True)
class SpotLookRequest:
    """Expose cameras for the light, all at the same time; exposure 0 stands for the nominal one [s]."""

    cameras: tuple[str, ...]
    exposure_s: float = 0.0


class SvcSpotLook(VisionService):
    """The first half of SpotFind: done when all is exposed; :class:`SvcSpotFind` has the second, by the look's name."""

    name: ClassVar[str] = "spot_look"

    def serve(self, client: VisionClient, request: SpotLookRequest) -> str:
        """Expose an image without light and one with it, common to all cameras; the name of the look.

        The images are read out and searched in a thread of their own, under the leases that any SpotFind has; once they
        are exposed, the search goes on for whoever asks for it, whatever becomes of this client.

        Raises:
            ImError: A camera is unknown, the exposure out of range, or the cameras do not expose.
        """
        look: Look[SpotFindResult] = Look(request.cameras)
        shut: Future[str] = Future()
        remarks: list[str] = []
        searcher = VisionClient(client.name, lambda: shut.done() or not client.gone, remarks.append)

        def exposed(stamps_ns: tuple[int, ...]) -> None:
            name = str(stamps_ns[-1])  # testbed time: no other look of this testbed ends then
            self.rig.looks.keep(name, look)
            shut.set_result(name)

        def search() -> None:
            watch = Stopwatch()
            try:
                spots, timing = find_in_pairs(self, searcher, request.cameras, request.exposure_s, watch, exposed)
                look.found.set_result(SpotFindResult(spots, {**timing, **watch.report()}, tuple(remarks)))
            except Exception as error:  # whatever it is, it is for whoever waits for the result
                look.found.set_exception(error)
                if not shut.done():
                    shut.set_exception(error)

        threading.Thread(target=search, name=client.name, daemon=True).start()
        return shut.result()
