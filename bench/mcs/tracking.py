"""How well the arms follow and rest: 18 joints at once, friction and encoder noise on, against the truth."""

import numpy as np
from numpy.typing import NDArray

from bench.figures import Line
from bench.mcs.rig import START, WAY, rig
from im_mcs.limits.configuration import McsConfig

_BARS_MRAD = {
    "im_mcs.control.pid_gravity:PidGravity": 1.0,
    "im_mcs.control.computed_torque:ComputedTorque": 0.2,
}
_REST_BAR_MRAD = 0.05


def lines(config: McsConfig, seed: int) -> list[Line]:
    """Errors on the way and at rest of every control law of the configuration; joint moves of over 1 rad."""
    config = config.with_preset("1x18")
    found = []
    for law in config.parameters_of_laws("testbed"):
        moving, resting = follow(config, law, seed)
        name = law.rpartition(":")[2]
        bar = _BARS_MRAD.get(law)
        found += [
            Line(f"{name}: error while moving, max", 1e3 * float(moving.max()), "mrad", bar=bar),
            Line(f"{name}: error while moving, rms", 1e3 * float(np.sqrt((moving**2).mean())), "mrad"),
            Line(
                f"{name}: error at rest, mean", 1e3 * float(resting.mean()), "mrad", bar=_REST_BAR_MRAD if bar else None
            ),
            Line(f"{name}: error at rest, max", 1e3 * float(resting.max()), "mrad"),
        ]
    return found


def follow(config: McsConfig, law: str, seed: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """True errors of all joints in each tick of motion, and at rest after each of three moves [rad or m]."""
    moving: list[NDArray[np.float64]] = []
    resting = []

    def watch() -> None:
        if machine.setpoint[1].any():
            moving.append(np.abs(machine.setpoint[0] - machine.true_q))

    with rig(config, seed) as machine:
        machine.to_motion("testbed")
        machine.ask("set_controller", group="testbed", controller=law)
        for target in (START, START + WAY, START):
            machine.move("testbed", target, on_tick=watch)
            resting.append(np.abs(machine.true_q - target))
    return np.array(moving), np.array(resting)
