"""What this computer is worth at the moment: figures that no change of the project alters, for others to be read by."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pybullet
from numpy.typing import NDArray

from bench.figures import Line
from im_cell.robot import load_cell
from im_core import clock
from im_sim.world import World

ADDITIONS = 10**7
_COPIED_BYTES = 64 * 2**20
_COPIES, _STEPS, _ROUNDS = 20, 500, 12


class BarePhysics:
    """The cell in pybullet, with nothing of the testbed's: no actuators, no friction, no sensors, no clock.

    Nothing holds the arms: they fall, and after a thousand steps lie on floor and table, where a step costs two to
    four times as much for the contacts as in any motion of the machine.

    Args:
        world: The cell, which nobody else steps.
        home: Where its joints are when the arms are lifted, shape (n,) [rad or m].
    """

    def __init__(self, world: World, home: NDArray[np.float64]) -> None:
        self._world, self._home = world, home
        self._torques = np.zeros(len(home))

    def lift(self) -> None:
        """Bring the arms back to where they touch nothing, and let go."""
        self._world.reset(self._home, self._torques)

    def step(self, count: int) -> None:
        """Let pybullet make steps, and nothing else."""
        for _ in range(count):
            pybullet.stepSimulation(self._world.client)

    def step_with_joints(self, count: int) -> None:
        """Let pybullet make steps; before each all joints are read, and all torques are written."""
        for _ in range(count):
            self._world.state()
            self._world.step(self._torques)


@contextmanager
def bare_physics() -> Iterator[BarePhysics]:
    """The shipped cell, bare; closed afterwards."""
    cell = load_cell()
    world = World(cell, cell.period / cell.substeps)
    try:
        yield BarePhysics(world, cell.home)
    finally:
        world.close()


def cpu_of(work: Callable[[], object]) -> float:
    """CPU time of a call [s]."""
    began = clock.cpu()
    work()
    return clock.cpu() - began


def lines() -> list[Line]:
    """The yardstick: CPU time, the least of some rounds, for whatever else runs only adds; and how much else runs."""
    with bare_physics() as bare:
        step_s = min(_fallen(bare) for _ in range(_ROUNDS)) / _STEPS
    source, target = np.ones(_COPIED_BYTES, np.uint8), np.zeros(_COPIED_BYTES, np.uint8)
    copy_s = min(cpu_of(lambda: np.copyto(target, source)) for _ in range(_COPIES))
    loop_s = min(cpu_of(_add) for _ in range(_ROUNDS))
    return [
        Line("Python loop of 10^7 additions", loop_s, "s"),
        Line("memcpy", _COPIED_BYTES / copy_s / 2**30, "GiB/s"),
        Line("pybullet step, both arms", 1e6 * step_s, "us"),
        Line("load average", os.getloadavg()[0], "", None, f"{os.cpu_count()} processors, {_processor()}"),
    ]


def _fallen(bare: BarePhysics) -> float:
    """CPU time of steps in which nothing is touched [s]."""
    bare.lift()
    return cpu_of(lambda: bare.step(_STEPS))


def _processor() -> str:
    told = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    return next((line.partition(":")[2].strip() for line in told if line.startswith("model name")), "of no known name")


def _add() -> int:
    total = 0
    for number in range(ADDITIONS):
        total += number
    return total
