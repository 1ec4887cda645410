"""Expected duration of a calibrate_camera command by the nets, beside the true one."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from im_dispatcher.report import StepTime
from im_pnt.model.net import Net
from im_pnt_analysis import CommandDuration, compare, expected_command

#: Ways back into the loop, and runs of the simulation where the expectation is not exact.
LOOPS = ("plan_ahead.plan", "read_next_pos.unplanned", "skip_again")
RUNS = 200


def expectation(nets: Sequence[Net], symbol: str, poses: int) -> CommandDuration:
    """Expected duration of a command, from the delays of the nets.

    Args:
        nets: The net that reads the symbol, first, and those whose services it needs.
        symbol: The command.
        poses: Poses that its loop visits.

    Raises:
        NetError: The nets do not say how long anything takes, or one is missing.
    """
    loop = nets[0]
    transitions = {
        name: replace(t, weight=float(poses - 1)) if name in LOOPS else t for name, t in loop.transitions.items()
    }
    return expected_command([replace(loop, transitions=transitions), *nets[1:]], symbol, runs=RUNS)


def beside(expected: CommandDuration, steps: Mapping[str, StepTime], duration_s: float) -> dict[str, object]:
    """The expected and the measured run, for the report.

    Args:
        expected: The expectation.
        steps: Measured time of each transition.
        duration_s: Measured testbed time of the command [s].
    """
    measured = {name: [step.simulated_s / step.count] * step.count for name, step in steps.items()}
    return {
        "expected_s": round(expected.mean, 3),
        "measured_s": round(duration_s, 3),
        "bottleneck": expected.bottleneck.transition,
        "bottleneck_s": round(expected.bottleneck.critical, 3),
        "method": expected.method,
        "steps": {
            row.transition: {
                "expected_count": round(row.expected_firings, 3),
                "measured_count": row.measured_firings,
                "expected_s": round(row.expected_mean, 4),
                "measured_s": None if row.measured_mean is None else round(row.measured_mean, 4),
            }
            for row in compare(expected, measured)
            if row.expected_mean > 0.0
        },
    }
