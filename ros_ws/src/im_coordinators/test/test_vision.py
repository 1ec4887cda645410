"""What the Vision Coordinator decides."""

import pytest

from im_coordinators.vision import another_look_may_help, require_spot
from im_core.errors import DataError, ImError


@pytest.mark.parametrize(
    ("causes", "expected"),
    [
        (["too faint: snr 3.1 < 6"], True),
        (["too faint: snr 3.1 < 6", "3 candidates of equal rank"], True),
        (["blocked: nothing brighter than the noise"], False),
        (["too faint: snr 3.1 < 6", "light is off"], False),
        ([], False),
    ],
)
def test_only_what_exposure_can_mend_is_looked_at_again(causes: list[str], expected: bool) -> None:
    with pytest.raises(DataError, match="no camera sees the light") as caught:
        require_spot({str(number): cause for number, cause in enumerate(causes)}, len(causes))
    assert another_look_may_help(caught.value) is expected


def test_without_spots_that_were_missed_nothing_is_looked_at_again() -> None:
    assert not another_look_may_help(None)
    assert not another_look_may_help(ImError("the camera is gone"))


def test_one_camera_that_sees_the_light_is_enough() -> None:
    require_spot({"wall": "too faint"}, 2)
    with pytest.raises(DataError, match="no camera sees the light: wall: too faint; floor: blocked") as caught:
        require_spot({"wall": "too faint", "floor": "blocked"}, 2)
    assert (caught.value.code, caught.value.facts["causes"]) == ("spot_not_found", ["too faint", "blocked"])
