"""``model``: prints kinematics and dynamics of a group, for comparison with other programs."""

import argparse
import json
import sys
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from im_cell.robot import Cell, load_cell
from im_core.errors import ImError
from im_mcs.limits.configuration import load_config
from im_mcs.model.part import Part, PartModel, parse_positions, part_of

_EXAMPLE = "[0,0.785,3.14,0,0.785,0]"
_EPILOG = f"""\
groups:
  <group>_arm           the joints of an arm alone, what carries it upright: poses are those of the tip in the base of
                        the cell file's group
  <group>               a group of a preset, with what carries it: poses are those of the tips in the world

what is printed:
  forward_kinematics    pose of the wrist in the base, 4 x 4 [m]; with two wrists, one by frame
  gravity_torques       what the motors must give to hold still [Nm, N for the track]
  inertia               joint-space inertia of the links [kg m2; kg and kg m where the track is concerned]
  inertia_with_motor    the same with the rotors, reflected through the gears

Joints that are not in the group stand still, at home. Positions beyond the end stops are computed too, with a warning
on standard error. Exit codes: 0, or 2 when something about the arguments is wrong.

example:
  scripts/run.sh im_mcs model --q "{_EXAMPLE}" --json
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Print forward kinematics, gravity torques and inertia of a group of joints at a position."""
    parser = argparse.ArgumentParser(
        prog="model",
        description=main.__doc__,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--group", help="group of joints (default: the arm of the cell's first group)")
    parser.add_argument("--preset", help="preset of mcs.yaml whose group is meant (default: the one in force first)")
    parser.add_argument(
        "--q", metavar="LIST", help=f"positions in the group's order [rad, m], e.g. '{_EXAMPLE}' (default: home)"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object instead of tables")
    options = parser.parse_args(arguments)
    try:
        cell = load_cell()
        group = options.group or f"{next(iter(cell.groups))}_arm"
        part = part_of(group, load_config(cell=cell), cell, options.preset)
        model = PartModel(part, cell)
        q = model.home if options.q is None else parse_positions(options.q, part)
    except ImError as error:
        print(f"model: {error.message}", file=sys.stderr)
        return 2
    warnings = model.warnings(q.tolist())
    for warning in warnings:
        print(f"model: warning: {warning}; computed all the same", file=sys.stderr)
    print(json.dumps(report(model, q, cell)) if options.json else tables(model, q, cell))
    return 0


def report(model: PartModel, q: NDArray[np.float64], cell: Cell) -> dict[str, object]:
    """All there is to say about a part at ``q``, as JSON data."""
    part = model.part
    poses = {frame: pose.tolist() for frame, pose in model.poses(q).items()}
    return {
        "group": part.name,
        "joints": list(part.joints),
        "units": list(model.units),
        "q": q.tolist(),
        "base_frame": part.base,
        "wrist_frame": part.wrists[0] if len(poses) == 1 else list(poses),
        "forward_kinematics": poses[part.wrists[0]] if len(poses) == 1 else poses,
        "gravity_torques": model.gravity(q).tolist(),
        "inertia": model.inertia(q, motors=False).tolist(),
        "inertia_with_motor": model.inertia(q, motors=True).tolist(),
        "sources": sources(part, cell),
        "warnings": model.warnings(q.tolist()),
    }


def sources(part: Part, cell: Cell) -> dict[str, str]:
    """Where the parameters of a part's arms and carts are from."""
    said = {}
    for name, group in cell.groups.items():
        arm, carriers = cell.arm_of(name), cell.carriers_of(group.base)
        for rank, (what, source) in enumerate(group.source.items()):
            if set(part.joints) & set(carriers if rank and carriers else arm):
                said[f"{name}: {what}"] = source
    return said


def tables(model: PartModel, q: NDArray[np.float64], cell: Cell) -> str:
    """The same for the eye."""
    part = model.part
    width = max(len(joint) for joint in part.joints)
    lines = [f"group {part.name}"]
    lines += [f"  {what}: {source}" for what, source in sources(part, cell).items()]
    lines += ["", f"{'joint':{width}}  {'position':>12}       {'gravity torque':>14}"]
    for joint, value, unit, tau in zip(part.joints, q, model.units, model.gravity(q), strict=True):
        lines.append(f"{joint:{width}}  {value:12.6f} {unit:<4}  {_fixed(tau):>14} {'N' if unit == 'm' else 'Nm'}")
    for frame, pose in model.poses(q).items():
        lines += ["", f"pose of {frame} in {part.base} [m]", *_matrix(pose)]
    kilograms = "kg m2" if "m" not in model.units else "kg m2; kg and kg m in the rows and columns of a track"
    lines += ["", f"inertia of the links [{kilograms}]", *_matrix(model.inertia(q, motors=False))]
    lines += ["", f"inertia with the motors [{kilograms}]", *_matrix(model.inertia(q, motors=True))]
    return "\n".join(lines)


def _matrix(matrix: NDArray[np.float64]) -> list[str]:
    cells = [[_fixed(value) for value in row] for row in matrix]
    width = max(len(text) for row in cells for text in row)
    return ["  " + "  ".join(f"{text:>{width}}" for text in row) for row in cells]


def _fixed(value: float) -> str:
    text = f"{value:.6f}"
    return text if text != "-0.000000" else "0.000000"


if __name__ == "__main__":
    sys.exit(main())
