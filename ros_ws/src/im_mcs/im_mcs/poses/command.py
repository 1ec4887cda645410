"""``poses``: writes a file of wrist poses for a calibration."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pinocchio as pin

from im_cell.robot import Group, load_cell
from im_core.errors import DataError, ImError, NotFoundError, StateError
from im_core.files import write_whole
from im_core.options import NumberParser, at_least, finite_number
from im_mcs.collision import CollisionChecker
from im_mcs.limits.configuration import McsConfig, load_config
from im_mcs.limits.limits import JointLimits
from im_mcs.model import CellModel
from im_mcs.poses.candidates import carried
from im_mcs.poses.selection import PoseSelector, Selection
from im_mcs.poses.view import rides_on, stand

_HEADER = """\
# Wrist poses for a calibration: the {target} fills what {cameras} see{s} and faces {them}.
# Reachable and free of collisions one after the other, with any other arm at home.
# {spread}.
"""

_EPILOG = """\
The poses fill all that the group's light can reach and all cameras see. A camera on an arm is where the arm has it at
home, and the other arm carries the light.

exit codes: 0 the poses are written; 1 there are no such poses, and why; 2 wrong arguments

examples:  scripts/run.sh im_mcs poses --cameras wall table --output poses.yaml
           scripts/run.sh im_mcs poses --count 30
           scripts/run.sh im_mcs poses --target board --cameras wall --output board_wall.yaml
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Generate poses; exit code 1 on failure, with the reason on standard error."""
    options = _parser().parse_args(arguments)
    try:
        cameras = options.cameras or list(load_cell().cameras)[:2]
        selector, group = make_selector(options.config, options.group, cameras, options.target)
        selection = selector.select(options.count, np.radians(options.tilt), options.seed, _told)
        text = to_yaml(group, cameras, selection, options.target)
        if options.output is None:
            print(text, end="")
        else:
            write_whole(options.output, text)
            print(f"{len(selection.poses)} poses of {group} written to {options.output}: {_spread(selection)}")
    except (ImError, OSError) as error:
        print(f"poses: {error}", file=sys.stderr)
        return 1
    return 0


def _told(sentence: str) -> None:
    print(f"poses: {sentence}", file=sys.stderr)


def _parser() -> argparse.ArgumentParser:
    parser = NumberParser(
        prog="poses",
        description="Write a file of wrist poses that fill the common view of cameras with the wrist light.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--group", help="group with the light (default: the first without a camera)")
    parser.add_argument(
        "--target", choices=("light", "board"), default="light", help="what the group shows them (%(default)s)"
    )
    parser.add_argument("--count", type=at_least(1), default=40, help="number of poses (%(default)s)")
    parser.add_argument("--cameras", nargs="+", help="cameras in use (default: the first two of the cell)")
    parser.add_argument(
        "--tilt", type=_tilt, default=50.0, help="largest tilt away from the cameras [deg] (%(default)s)"
    )
    parser.add_argument("--seed", type=at_least(0), default=1, help="seed of the candidates (%(default)s)")
    parser.add_argument("--config", type=Path, help="configuration of MCS (default: the shipped one)")
    parser.add_argument("--output", type=Path, help="file to write (default: standard output)")
    return parser


def _tilt(text: str) -> float:
    if not 0.0 <= (value := finite_number(text)) <= 180.0:
        raise argparse.ArgumentTypeError(f"{text} is no angle from 0 to 180 deg")
    return value


def make_selector(
    config_file: Path | None, group: str | None, cameras: Sequence[str], target: str = "light"
) -> tuple[PoseSelector, str]:
    """Return the selector of poses for cameras, and the name of the group with the light.

    Args:
        config_file: Configuration of MCS; None: the shipped one.
        group: Name of the group; None: the first that has a wrist and carries none of the cameras.
        cameras: Names of the cameras.
        target: What it shows them, ``light`` or ``board``.

    Raises:
        NotFoundError: No such group or camera.
        ConfigError: The group has no board.
        StateError: The group has no wrist, or a camera rides on it.
        DataError: A camera is given twice, or the cameras see no place in common that the light can reach.
    """
    cell = load_cell()
    config, model = load_config(config_file, cell), CellModel(cell)
    for camera in cameras:
        if camera not in model.cell.cameras:
            raise NotFoundError(kind="camera", name=camera, known=model.cell.cameras)
        if cameras.count(camera) > 1:
            raise DataError(f"camera '{camera}' is given twice", camera=camera)
    group = group or _group_for(config, model, cameras)
    if group not in config.groups:
        raise NotFoundError(kind="group", name=group, known=config.groups)
    description = config.groups[group]
    if description.wrist is None:
        raise StateError(f"group '{group}' has no wrist", group=group)
    selector = PoseSelector(
        model=model,
        limits=JointLimits(model.cell, config.limits, config.slots),
        checker=CollisionChecker(model, config.collision.clearance_m),
        index=np.array([model.index(joint) for joint in description.joints], dtype=np.intp),
        frame=description.wrist,
        views=stand(model, cameras, group, description.joints, cell.led.diameter if target == "light" else 0.0),
        shown=carried(cell, cell.board_of(group) if target == "board" else None),
    )
    return selector, group


def _group_for(config: McsConfig, model: CellModel, cameras: Sequence[str]) -> str:
    """Return the first group with a wrist and without any of the cameras."""
    mounts = {model.cell.cameras[camera].parent for camera in cameras} - {"world"}

    def serves(group: Group) -> bool:
        return group.wrist is not None and not any(rides_on(model, mount, group.joints) for mount in mounts)

    for name, group in config.groups.items():
        if serves(group):
            return name
    raise StateError(f"every arm carries one of the cameras {', '.join(cameras)}; none is left for the light")


def to_yaml(group: str, cameras: Sequence[str], selection: Selection, target: str = "light") -> str:
    """The file's text: poses in free order, with their joints."""
    s, them = ("s", "it") if len(cameras) == 1 else ("", "them")
    told = _spread(selection).capitalize()
    header = _HEADER.format(target=target, cameras=" and ".join(cameras), s=s, them=them, spread=told)
    others = [f"other_joints: {list(each.home)}" for name, each in load_cell().groups.items() if name != group]
    lines = [header + f"group: {group}", "frame: world", *others, "order: free", "poses:"]
    width = len(str(len(selection.poses)))
    for number, one in enumerate(selection.poses, start=1):
        wrist = one.candidate.wrist
        position = ", ".join(f"{value:.4f}" for value in wrist.translation)
        quaternion = ", ".join(f"{value:.6f}" for value in pin.Quaternion(wrist.rotation).coeffs())
        lines.append(f"  - {{name: p{number:0{width}d}, position_m: [{position}], orientation_xyzw: [{quaternion}],")
        lines.append(f"     joints: [{', '.join(f'{joint:.4f}' for joint in one.q)}]}}")
    return "\n".join(lines) + "\n"


def _spread(selection: Selection) -> str:
    spread = selection.spread
    return (
        f"lights at least {spread.nearest_m:.2f} m apart, no usable place farther than {spread.hole_m:.2f} m from one; "
        f"turning of the wrist {spread.turning:.2f} of 1"
    )


if __name__ == "__main__":
    sys.exit(main())
