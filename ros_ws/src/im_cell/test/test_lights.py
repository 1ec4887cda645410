"""Which lights are on, by what the testbed says; what another says on its topic does not count."""

import pytest

from im_cell.lights import lights_told
from im_cell.robot import load_cell
from im_core.errors import DataError


def test_a_light_is_as_the_testbed_says() -> None:
    told = '{"left_led": true, "right_led": false}'
    assert lights_told(told, load_cell()) == {"left_led": True, "right_led": False}


@pytest.mark.parametrize(
    "text", ["", "no JSON", "[]", "{}", '{"lamp": true}', '{"left_led": true}', '{"left_led": 1, "right_led": 0}']
)
def test_what_the_testbed_would_not_say_is_refused(text: str) -> None:
    with pytest.raises(DataError, match="the state of the lights"):
        lights_told(text, load_cell())
