"""``poses``: writes a file of wrist poses for a calibration."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pinocchio as pin

from im_core.errors import ImError, NotFoundError, StateError
from im_core.robot import load_cell
from im_mcs.collision import CollisionChecker
from im_mcs.config import load_config
from im_mcs.limits import JointLimits
from im_mcs.model import Model
from im_mcs.poses.candidates import Volume
from im_mcs.poses.selection import Placed, PoseSelector

_HEADER = """\
# Wrist poses for a calibration: the light fills the workspace and faces {cameras}.
# Reachable and free of collisions one after the other, with the other arm at home.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Generate poses; exit code 1 if it cannot be done, with the reason on standard error."""
    parser = argparse.ArgumentParser(prog="poses", description=main.__doc__)
    parser.add_argument("--group", default="left", help="group that carries the light")
    parser.add_argument("--count", type=int, default=40, help="number of poses")
    parser.add_argument("--cameras", nargs="+", default=["ceiling_left", "ceiling_right"], help="that see the light")
    parser.add_argument("--tilt", type=float, default=40.0, help="largest tilt away from the cameras [deg]")
    parser.add_argument("--lower", nargs=3, type=float, default=[-1.0, -0.5, 0.6], help="corner of the volume [m]")
    parser.add_argument("--upper", nargs=3, type=float, default=[1.0, 0.5, 1.6], help="opposite corner [m]")
    parser.add_argument("--seed", type=int, default=1, help="of the candidates")
    parser.add_argument("--config", type=Path, help="configuration of MCS (default: the shipped one)")
    parser.add_argument("--output", type=Path, help="file to write (default: standard output)")
    options = parser.parse_args(arguments)
    try:
        volume = Volume(np.array(options.lower), np.array(options.upper))
        selector = make_selector(options.config, options.group, options.cameras)
        placed = selector.select(options.count, volume, np.radians(options.tilt), options.seed)
        text = to_yaml(options.group, options.cameras, placed)
        if options.output is None:
            print(text, end="")
        else:
            options.output.write_text(text, encoding="utf-8")
            print(f"{len(placed)} poses written to {options.output}")
    except (ImError, OSError) as error:
        print(error, file=sys.stderr)
        return 1
    return 0


def make_selector(config_file: Path | None, group: str, cameras: Sequence[str]) -> PoseSelector:
    """What finds poses of a group for cameras.

    Raises:
        NotFoundError: No such group or camera.
        StateError: The group has no wrist.
    """
    config, cell = load_config(config_file), load_cell()
    if group not in config.groups:
        raise NotFoundError(kind="group", name=group, known=config.groups)
    description = config.groups[group]
    if description.wrist is None:
        raise StateError(f"group '{group}' has no wrist", group=group)
    for camera in cameras:
        if camera not in cell.cameras:
            raise NotFoundError(kind="camera", name=camera, known=cell.cameras)
        if cell.cameras[camera].parent != "world":
            raise StateError(f"camera '{camera}' moves with {cell.cameras[camera].parent}; it has no place to face")
    model = Model(cell)
    return PoseSelector(
        model=model,
        limits=JointLimits(model, config.limits, config.slots),
        checker=CollisionChecker(model, config.collision.clearance_m),
        index=np.array([model.index(joint) for joint in description.joints], dtype=np.intp),
        frame=description.wrist,
        cameras=[cell.cameras[camera] for camera in cameras],
    )


def to_yaml(group: str, cameras: Sequence[str], placed: Sequence[Placed]) -> str:
    """The file's text; one pose a line."""
    lines = [_HEADER.format(cameras=" and ".join(cameras)) + f"group: {group}", "frame: world", "poses:"]
    width = len(str(len(placed)))
    for number, one in enumerate(placed, start=1):
        wrist = one.candidate.wrist
        position = ", ".join(f"{value:.4f}" for value in wrist.translation)
        quaternion = ", ".join(f"{value:.6f}" for value in pin.Quaternion(wrist.rotation).coeffs())
        lines.append(f"  - {{name: p{number:0{width}d}, position_m: [{position}], orientation_xyzw: [{quaternion}]}}")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
