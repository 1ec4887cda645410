"""Whoever says something in the log is told as rclpy tells it, which looks for it in a way that takes much longer."""

import pytest
from rclpy.impl import rcutils_logger
from rclpy.impl.rcutils_logger import RcutilsLogger

from im_core.ros import logger as module
from im_core.ros.logger import Logger


@pytest.fixture
def told(monkeypatch):
    """What reached the library."""
    lines = []
    for user in (rcutils_logger._rclpy, module.rclpy_implementation):
        monkeypatch.setattr(user, "rclpy_logging_rcutils_log", lambda *line: lines.append(line))
    return lines


@pytest.mark.parametrize("say", ["info", "warning", "error", "fatal"])
def test_function_file_and_line_are_those_that_rclpy_finds(told, say):
    for each in (Logger("it"), RcutilsLogger("it")):
        assert getattr(each, say)("something")
    assert told[0] == told[1]
    assert told[0][1:4] == ("it", "something", "test_function_file_and_line_are_those_that_rclpy_finds")


def test_what_is_below_the_level_is_not_told(told):
    assert not Logger("it").debug("something")
    assert not told


def test_what_is_said_once_is_told_once(told):
    logger = Logger("it")
    assert [logger.info("something", once=True) for _ in range(3)] == [True, False, False]
    assert len(told) == 1
