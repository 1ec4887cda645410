"""Spots of a recorded calibration, found anew in the recorded images."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from im_bag.reading import messages_of, topics_of
from im_calibration import SeenSpot
from im_calibration.problem.bags import RecordedCalibration
from im_calibration.recorded.image_message import grey_image
from im_calibration.recorded.stamps import stamp_of
from im_core.errors import DataError
from im_vss.services.calibrate import CalibrateRequest
from im_vss.settings import VssSettings
from im_vss.spot import SearchDisc, find_spot

_LOOKS, _LOOK = "/vss/spot_find/_service_event", "im_msgs/srv/SpotFind_Event"
_IMAGE = "sensor_msgs/msg/Image"
#: What is read of the messages of this workspace.
_FIELDS = {
    "im_msgs/srv/SpotFind_Response": ("candidates",),
    "im_msgs/msg/SpotCandidates": ("camera", "stamp", "predicted", "u", "v", "radius"),
}
_PAIR_NS = 500_000_000
"""The exposure without light comes right before the one with it; an older image is of another look."""


def find_again(
    bag: Path,
    call: RecordedCalibration,
    request: CalibrateRequest,
    settings: VssSettings,
    progress: Callable[[str], None],
) -> tuple[CalibrateRequest, str]:
    """Find the spots of a request in the recorded images, in the looks of the observations.

    Returns:
        The request with the spots found, and how they differ from the recorded ones, as a sentence.

    Raises:
        DataError: The bag cannot be read, or holds none of the images.
    """
    looked = {
        (str(spot.camera), stamp_of(spot)): i
        for i, observation in enumerate(call.request.observations)
        for spot in observation.spots
        if spot.camera in request.cameras
    }
    discs = _search_discs(bag)
    observations = [replace(observation, spots={}) for observation in request.observations]
    seen: set[tuple[str, int]] = set()
    for camera in request.cameras:
        for stamp, off, on in _pairs(bag, camera, {stamp for name, stamp in looked if name == camera}):
            seen.add((camera, stamp))
            finding = find_spot(on, off, settings.sensor, settings.spot, discs.get((camera, stamp)))
            if (spot := finding.spot) is not None:
                spots = observations[looked[camera, stamp]].spots
                spots[camera] = SeenSpot(np.array([spot.u, spot.v]), spot.covariance, stamp)
            progress(f"{len(seen)} of {len(looked)} pairs of images")
    if not seen:
        topics = ", ".join(f"/{camera}/image_raw" for camera in request.cameras)
        raise DataError(f"{bag}: the images of its {len(looked)} looks are not in it ({topics}); were they recorded?")
    both = [(now.spots, before.spots) for now, before in zip(observations, request.observations, strict=True)]
    lost = sum(len(before.keys() & set(request.cameras) - now.keys()) for now, before in both)
    moves = [np.linalg.norm(now[name].uv - before[name].uv) for now, before in both for name in now.keys() & before]
    told = (
        f"{sum(len(now) for now, _ in both)} spots found in the images, {lost} of the recorded ones not; "
        f"the others moved by {max(moves, default=0.0):.3g} px at most"
    )
    if missing := len(looked) - len(seen):
        told += f"; {missing} looks are left out, their images are not in the bag"
    return replace(request, observations=tuple(observations)), told


def _search_discs(bag: Path) -> dict[tuple[str, int], SearchDisc]:
    """Where each look was confined to, by camera and stamp of the exposure."""
    if _LOOKS not in topics_of(bag):
        return {}
    return {
        (str(each.camera), stamp_of(each)): SearchDisc(each.u, each.v, each.radius)
        for message in messages_of(bag, {_LOOKS: (_LOOK,)}, _FIELDS)
        for response in message.content.response
        for each in response.candidates
        if each.predicted
    }


def _pairs(bag: Path, camera: str, stamps: set[int]) -> Iterator[tuple[int, Any, Any]]:
    """Yield stamp, image without light and image with light, of each look of a camera with images in the bag."""
    topic = f"/{camera}/image_raw"
    if topic not in topics_of(bag):
        return
    before: tuple[int, Any] | None = None
    for message in messages_of(bag, {topic: (_IMAGE,)}):
        stamp, image = stamp_of(message.content.header), grey_image(message.content, topic)
        follows = before is not None and before[0] not in stamps and 0 < stamp - before[0] < _PAIR_NS
        if stamp in stamps and follows and before is not None and before[1].shape == image.shape:
            yield stamp, before[1], image
        before = stamp, image
