"""Commands for a machine that runs for long: calibrations one after another, or what a day brings, from a seed."""

import json
import random
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from rclpy.action import ActionClient

from im_bringup.ros.interruptible import InterruptibleNode
from im_cell.robot import load_cell
from im_core import clock, config
from im_core.errors import StateError, WaitTimeoutError
from im_core.message_paths import hand_over
from im_core.ros.guard import GuardedActionClient
from im_msgs.action import ExecuteCommand

ANSWER_S = 600.0
_FEW = 18  # enough remain where the way of the arm hides its light at some
_NEAR_RAD = 0.2
_CART_JOINTS = 3


@dataclass(frozen=True)
class Outcome:
    """How a command ended.

    Attributes:
        name: What was asked.
        as_it_should: Whether it ended as it should: with success, or refused, or cancelled.
        message: What it said.
        duration_s: Wall time [s].
    """

    name: str
    as_it_should: bool
    message: str
    duration_s: float


class Commander(InterruptibleNode):
    """Commands the dispatcher, through its action."""

    def __init__(self, seed: int) -> None:
        super().__init__("soak")
        self._random = random.Random(seed)
        self._execute: ActionClient = GuardedActionClient(self, ExecuteCommand, "/dispatcher/execute")
        self._folder = tempfile.TemporaryDirectory(prefix="im_soak_")
        self._cell = load_cell()
        poses = config.package_file("im_cell", "cells/puma_pair/ceiling_40.yaml")
        self._poses: dict[str, Any] = yaml.safe_load(poses.read_text(encoding="utf-8"))

    def destroy_node(self) -> None:
        """Remove the poses files that were made."""
        self._folder.cleanup()
        destroy: Callable[[], None] = super().destroy_node  # rclpy says no types
        destroy()

    def whole_calibration(self) -> Outcome:
        """Calibrate the ceiling cameras with all poses of the cell."""
        return self._outcome("calibration", {}, self._succeeded)

    def any_command(self) -> Outcome:
        """One of what a day brings."""
        kinds = (self._short, self._plain, self._cancelled, self._refused)
        (kind,) = self._random.choices(kinds, weights=(3, 4, 2, 2))
        return kind()

    def _short(self) -> Outcome:
        return self._outcome("calibration of few poses", {"poses_file": self._some_poses()}, self._succeeded)

    def _cancelled(self) -> Outcome:
        arguments = {"poses_file": self._some_poses()}
        after_s = self._random.uniform(0.2, 8.0)
        return self._outcome("cancelled calibration", arguments, lambda result: not result.success, after_s)

    def _refused(self) -> Outcome:
        return self._outcome("unknown camera", {"cameras": ["nowhere"]}, lambda result: "nowhere" in said(result))

    def _plain(self) -> Outcome:
        """A command that needs no pose of the calibration; each works from cold."""
        side = self._random.choice(("left", "right"))
        width = round(self._random.uniform(0.0, self._cell.gripper.stroke), 3)
        commands: dict[str, dict[str, object]] = {
            "move": {"group": side, "joints": self._somewhere(side)},
            "home": {"group": side},
            "demo": {},
            "look": {"camera": "ceiling_left", "light": "left_led"},
            "open_gripper": {"group": side},
            "close_gripper": {"group": side, "width": width},
        }
        symbol = self._random.choice(sorted(commands))
        right = self._seen if symbol == "look" else self._succeeded
        return self._outcome(symbol, commands[symbol], right, symbol=symbol)

    @staticmethod
    def _seen(result: Any) -> bool:
        """Whether the light is in sight depends on where the last command left the arm."""
        return bool(result.success) or "spot" in said(result)

    def _somewhere(self, side: str) -> list[float]:
        """A position of each joint [m or rad], the arm's near those at home."""
        home = self._cell.groups[side].home
        near = [self._random.uniform(-_NEAR_RAD, _NEAR_RAD) for _ in home[_CART_JOINTS:]]
        return [*home[:_CART_JOINTS], *(round(at + by, 3) for at, by in zip(home[_CART_JOINTS:], near, strict=True))]

    @staticmethod
    def _succeeded(result: Any) -> bool:
        return bool(result.success)

    def _some_poses(self) -> str:
        first = self._random.randrange(len(self._poses["poses"]) - _FEW)
        path = Path(self._folder.name) / f"from_{first}.yaml"
        some = {**self._poses, "poses": self._poses["poses"][first : first + _FEW]}
        path.write_text(yaml.safe_dump(some), encoding="utf-8")
        return str(hand_over(path))

    def _outcome(
        self,
        name: str,
        arguments: Mapping[str, object],
        right: Callable[[Any], bool],
        cancel_after_s: float | None = None,
        symbol: str = "calibrate_camera",
    ) -> Outcome:
        began = clock.monotonic()
        goal = ExecuteCommand.Goal(symbol=symbol, arguments=json.dumps(dict(arguments)))
        if not self._execute.wait_for_server(ANSWER_S):
            raise WaitTimeoutError(what="the action of the dispatcher", seconds=ANSWER_S)
        assert self.executor is not None, "the node spins"
        # sent in the loop: rclpy notes a goal after it has sent it, and another thread may take the answer in between
        handle = self._done(self._done(self.executor.create_task(self._execute.send_goal_async, goal)))
        if not handle.accepted:
            raise StateError(f"{name}: the dispatcher did not accept the goal")
        answer = self._done(self.executor.create_task(handle.get_result_async))
        if cancel_after_s is not None:
            clock.sleep(cancel_after_s)
            self._done(self._done(self.executor.create_task(handle.cancel_goal_async)))
        result = self._done(answer).result
        return Outcome(name, right(result), said(result), clock.monotonic() - began)

    def _done(self, future: Any) -> Any:
        deadline = clock.monotonic() + ANSWER_S
        while not future.done():
            if clock.monotonic() > deadline:
                raise WaitTimeoutError(what="an answer of the dispatcher", seconds=ANSWER_S)
            clock.sleep(0.02)
        return future.result()


def said(result: Any) -> str:
    """What a command said."""
    return str(json.loads(result.results or "{}").get("message", "")) or str(result.status.message)
