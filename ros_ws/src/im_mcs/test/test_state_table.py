import itertools

import pytest

from im_core.errors import StateError
from im_mcs.state import TABLE, UNCONFIGURED_MESSAGE, Event, State, lifecycle_of, next_state
from im_mcs.state.table import allowed_in

ROWS = {(row.source, row.event): row.target for row in TABLE}


@pytest.mark.parametrize(("state", "event"), list(itertools.product(State, Event)))
def test_every_state_and_event(state, event):
    if (state, event) in ROWS:
        assert next_state(state, event) is ROWS[state, event]
        return
    with pytest.raises(StateError) as caught:
        next_state(state, event)
    message = caught.value.message
    if state is State.UNCONFIGURED:
        assert message == UNCONFIGURED_MESSAGE
    else:
        assert state.value in message
        assert event.value in message
        assert all(allowed.value in message for allowed in allowed_in(state))


def test_the_architecture_s_rows_are_there():
    expected = {
        (State.COLD, Event.RESERVE): State.RESERVED,
        (State.RESERVED, Event.POWER_ON): State.ACTIVE,
        (State.ACTIVE, Event.ENABLE_MOTION): State.MOTION,
        (State.MOTION, Event.DISABLE_MOTION): State.ACTIVE,
        (State.ACTIVE, Event.POWER_OFF): State.RESERVED,
        (State.RESERVED, Event.RELEASE): State.COLD,
        (State.ESTOPPED, Event.RESET): State.COLD,
        **{(s, Event.ESTOP): State.ESTOPPED for s in (State.RESERVED, State.ACTIVE, State.MOTION)},
    }
    assert expected.items() <= ROWS.items()
    assert (State.RESERVED, Event.ENABLE_MOTION) not in ROWS


def test_lifecycle_is_active_exactly_with_power():
    assert {s for s in State if lifecycle_of(s) == "active"} == {State.ACTIVE, State.MOTION}
