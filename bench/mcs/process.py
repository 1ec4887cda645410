"""What a control law in a process of its own costs the loop."""

import numpy as np

from bench.figures import Line
from im_cell.robot import load_cell
from im_core import clock
from im_mcs.control import ControlInput, LawSource
from im_mcs.limits.configuration import McsConfig
from im_mcs.model import ControlledModel
from im_mcs.planning import Setpoint

_LAW = "im_mcs.control.computed_torque:ComputedTorque"
_TIMES = 4000


def lines(config: McsConfig, seed: int) -> list[Line]:
    """Time until the torques of computed torque for 18 joints are there: from another process, and in this one."""
    cell = load_cell()
    moving = Setpoint(cell.home, *np.random.default_rng(seed).normal(0.0, 1.0, (2, 18)))
    medians = []
    for laws in ((), (_LAW,)):
        processes = config.law_processes.model_copy(update={"laws": laws})
        model = ControlledModel(cell)
        torque_limit = cell.per_joint("limits.torque")
        source = LawSource(config.model_copy(update={"law_processes": processes}), model, torque_limit, 0.0)
        try:
            control = source.laws_for("1x18", "testbed")
            control.switch(_LAW)
            control.reset()
            given = ControlInput(cell.home, np.zeros(18), moving, model.gravity(cell.home), cell.home, moving)
            spent = []
            for _ in range(_TIMES):
                began = clock.monotonic()
                control.command(given)
                spent.append(clock.monotonic() - began)
        finally:
            source.close()
        medians.append(1e6 * float(np.median(spent)))
    here, there = medians
    return [Line("computed torque, 18 joints, in a process of its own", there, "us", here, "in the loop")]
