"""Messages on topics that are refused: counted, and said once."""

import logging

from im_core.errors import ImError, LimitError
from im_mcs.ros.access import Refusals


def beyond(joint, value):
    return LimitError(joint=joint, value=value, limit=2.8, unit="rad", what="position of the setpoint")


def test_a_sentence_is_said_once_whatever_its_numbers(caplog):
    """A stream that goes on beyond a limit has another value in every message."""
    refusals = Refusals(logging.getLogger("mcs"))
    for value in (2.81, 2.9, 3, -2.91, 3.1e-07, 12.0):
        refusals.add("/left/joint_trajectory", beyond("left_j1", value))
    refusals.add("/left/joint_trajectory", beyond("left_j2", 2.81))
    refusals.add("/left/joint_trajectory", ImError("the servo hangs"))
    refusals.add("/right/joint_trajectory", beyond("right_j1", 2.81))
    said = [record.getMessage() for record in caplog.records]
    assert [each.partition(" ")[0] for each in said] == 3 * ["/left/joint_trajectory:"] + ["/right/joint_trajectory:"]
    assert said[0] == f"/left/joint_trajectory: {beyond('left_j1', 2.81).message}"
    assert "left_j2" in said[1]
    assert refusals.counts() == {"/left/joint_trajectory": 8, "/right/joint_trajectory": 1}
