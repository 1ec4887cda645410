"""The physics process: ``python -m im_sim.physics --instance NAME --factor 1.0 --seed 0``."""

import sys
from collections.abc import Sequence
from pathlib import Path

from im_cell.link import HostEnd
from im_cell.robot import load_cell
from im_cell.robot.truth import load_truth
from im_core.errors import ConfigError, ImError
from im_core.options import NumberParser
from im_core.processes import scheduling
from im_core.processes.end_signals import heed_end_signals
from im_sim.laser import Laser
from im_sim.loop import TickLoop
from im_sim.plant import Plant

FIFO_PRIORITY = 70  # below the servo, which it must not delay


def main(arguments: Sequence[str] | None = None) -> int:
    """Simulate until a signal asks to end.

    Returns:
        Exit code: 0 after an orderly end, 1 after an error, whose sentence is the last line written.
    """
    parser = NumberParser(prog="im_sim.physics", description="Physics of the simulated testbed.")
    parser.add_argument("--instance", required=True, help="name of the machine on this host")
    parser.add_argument("--period", type=float, default=0.0, help="period of a tick [s]; 0: the cell's")
    parser.add_argument("--factor", type=float, default=1.0, help="clock factor; 0: as fast as time is asked for")
    parser.add_argument("--seed", type=int, default=0, help="seed of the encoder noise")
    parser.add_argument("--truth", type=Path, help="file of what the cell is really like (default: as drawn)")
    options = parser.parse_args(arguments)
    try:
        simulate(options.instance, options.period, options.factor, options.seed, options.truth)
    except ImError as error:
        print(error.message, file=sys.stderr)
        return 1
    return 0


def simulate(instance: str, period: float, factor: float, seed: int, truth: Path | None) -> None:
    """Create the link and run the tick loop until a signal ends the loop.

    Raises:
        ConfigError: The cell's parameters are wrong, or masses or torques are missing.
        DataError: The file of the truth is malformed.
        LinkError: Another testbed of that instance runs.
    """
    cell = load_cell()
    if period != 0.0:
        cell = cell.at_period(period)
    if cell.unknown:
        raise ConfigError(f"the testbed cannot simulate this cell: {'; '.join(cell.unknown)}")
    grippers, wrenches = len(cell.devices("gripper")), len(cell.devices("force"))
    with HostEnd.create(
        instance, len(cell.joints), cell.period, factor, seed, cell.light_names, grippers, wrenches
    ) as link:
        plant = Plant(cell if truth is None else load_truth(truth).built(cell), seed)
        loop = TickLoop(plant, Laser(cell.laser, cell.period, seed), link)
        heed_end_signals(lambda _: loop.stop())
        scheduling.prefer(FIFO_PRIORITY, paced=factor > 0.0)
        loop.run()
        plant.close()


if __name__ == "__main__":
    sys.exit(main())
