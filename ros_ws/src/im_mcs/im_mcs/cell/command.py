"""``cell``: writes the first cell file of a URDF, checks cell files, and exports cells for other tools."""

import argparse
import sys
from collections.abc import Sequence
from itertools import chain
from pathlib import Path

import numpy as np

from im_cell.robot import Cell, cell_file, load_cell
from im_core.errors import ImError
from im_core.files import write_whole
from im_core.options import NumberParser
from im_core.output import complain, say
from im_mcs.cell.capsules import capsule_volume
from im_mcs.cell.semantics import moveit_files
from im_mcs.cell.template import first_cell, samples_of, touching_pairs
from im_mcs.cell.torques import acceleration_share
from im_mcs.cell.views import foxglove_layout, rviz_config
from im_mcs.collision.bodies import hull_of
from im_mcs.inverse.arm import ARM_JOINTS, FEWEST_JOINTS
from im_mcs.inverse.closed_form import ClosedForm
from im_mcs.limits.configuration import load_config
from im_mcs.model import CellModel

_KEPT = {
    5: "straight lines keep the position, and the orientation but for turns about one axis of the tip",
    4: "straight lines keep the position, and turns about one axis of the tip",
    3: "straight lines keep the position alone",
}
_BUILD = {
    None: "by iteration",
    True: "in closed form, by a spherical wrist",
    False: "in closed form, by three parallel axes",
}
_NO_LINES = f"no straight lines: they need {FEWEST_JOINTS} joints or more"
_EPILOG = """\
exit codes: 0 done; 1 the cell cannot be used, and why; 2 wrong arguments

examples:  scripts/im cell new my_robot.urdf --output my_cell.yaml
           scripts/im cell check my_cell.yaml --picture my_cell.png
           scripts/start.sh --cell my_cell.yaml
           scripts/im cell export my_cell.yaml --output my_cell_views
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Write, check or export a cell; exit code 1 on failure, with the reason on standard error."""
    options = _parser().parse_args(arguments)
    try:
        if options.command == "new":
            text = first_cell(options.urdf, options.srdf, options.output and options.output.parent)
            if options.output is None:
                say(text.removesuffix("\n"))
                return 0
            write_whole(options.output, text)
            say(f"{options.output}: a first cell file; `im cell check {options.output}` says what it leaves open")
            return 0
        if options.command == "export":
            for file in exported(load_cell(options.cell), options.mcs, options.output):
                say(str(file))
            return 0
        say("\n".join(findings(load_cell(options.cell), str(cell_file(options.cell)))))
        if options.picture is not None:
            from im_mcs.cell.picture import draw  # matplotlib takes half a second

            draw(load_cell(options.cell), options.picture)
            say(f"picture: {options.picture}")
    except (ImError, OSError) as error:
        complain(f"im cell: {error}")
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = NumberParser(
        prog="im cell",
        description="Write the first cell file of a URDF, check a cell file, or write what other tools read of a cell.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="new|check|export")
    new = commands.add_parser("new", help="write the first cell file of a URDF")
    new.add_argument("urdf", type=Path, help="the URDF; its meshes are looked for beside it and in ROS packages")
    new.add_argument(
        "--srdf",
        type=Path,
        help="pairs of links not compared (default: all that always touch)",
    )
    new.add_argument("--output", type=Path, help="file to write (default: standard output, for the folder of the URDF)")
    check = commands.add_parser("check", help="say what a cell file leaves open, and what is assumed for it")
    check.add_argument("cell", help="cell file, or name of a shipped cell")
    check.add_argument("--picture", type=Path, help="file for a picture of the cell at home, such as cell.png")
    export = commands.add_parser("export", help="write the files that MoveIt, RViz and Foxglove read of a cell")
    export.add_argument("cell", help="cell file, or name of a shipped cell")
    export.add_argument("--mcs", type=Path, help="configuration of MCS: preset and limits (default: the shipped one)")
    export.add_argument("--output", type=Path, required=True, help="folder of the files; made if it is not there")
    return parser


def exported(cell: Cell, mcs: Path | None, folder: Path) -> list[Path]:
    """Write the files of a cell for MoveIt, RViz and Foxglove, and return the paths.

    Raises:
        ImError: The configuration of MCS does not fit the cell.
        OSError: A file cannot be written.
    """
    texts = {
        **moveit_files(cell, load_config(mcs, cell)),
        "cell.rviz": rviz_config(cell),
        "foxglove.json": foxglove_layout(cell),
    }
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        write_whole(folder / name, text)
    return [folder / name for name in texts]


def findings(cell: Cell, file: str) -> list[str]:
    """Return sentences about a cell: its groups, missing and assumed data."""
    lines = [f"{file}: {_joints(len(cell.joints))}"]
    model = CellModel(cell)
    for name, group in cell.groups.items():
        devices = [device for device in ("gripper", "force", "light") if getattr(group, device)]
        with_ = f", with {' and '.join(devices)}" if devices else ""
        lines.append(f"group {name}: {_joints(len(cell.joints_of(name)))} to {group.tip}{with_}")
        if (count := len(cell.carriers_of(group.tip))) < ARM_JOINTS:
            lines.append(f"group {name}: {_KEPT.get(count, _NO_LINES)}")
        closed = ClosedForm.of(model, group.tip, model.joints_below(group.tip))
        lines.append(f"group {name}: inverse kinematics {_BUILD[None if closed is None else closed.spherical]}")
    lines += [f"missing: {sentence}; torques cannot be computed" for sentence in cell.unknown]
    lines += [] if cell.unknown else _weak(cell, model)
    lines += [f"missing: {what}" for what, there in _optional(cell).items() if not there]
    lines += [f"assumed: {sentence}" for sentence in cell.assumed]
    lines += _shapes(cell)
    lines += [f"touching at home: {first} and {second}" for first, second in touching_pairs(cell)]
    return lines


def _joints(count: int) -> str:
    return "1 joint" if count == 1 else f"{count} joints"


def _weak(cell: Cell, model: CellModel) -> list[str]:
    """Return sentences about joints without the torque for what is asked of them."""
    torque, holding = cell.per_joint("limits.torque"), np.abs(model.gravity(cell.home))
    lines = [
        f"too weak: {name} gives up to {given:g}, and needs {needed:.3g} to hold the arm at home [Nm or N]"
        for name, given, needed in zip(cell.joint_names, torque, holding, strict=True)
        if needed > given
    ]
    shares = acceleration_share(cell, samples_of(cell, 0.0))
    if shares.min() < 1.0 and not lines:
        told = ", ".join(
            f"{name} {100.0 * max(share, 0.0):.0f} %"
            for name, share in zip(cell.joint_names, shares, strict=True)
            if share < 1.0
        )
        lines.append(f"too fast: in half of all positions torques afford only part of full acceleration: {told}")
    return lines


def _shapes(cell: Cell) -> list[str]:
    """Return sentences about the compared shapes, and the moving links without one."""
    shaped = {*(body.link for body in cell.bodies), *(hull.link for hull in cell.hulls)}
    seen = {cell.tree.carrier(link).parent for link in shaped}
    bare = [link.name for link in cell.links if link.name not in seen]
    lines = [f"missing: shapes of {', '.join(bare)}; collisions of these links are not seen"] if bare else []
    rounded = dict.fromkeys(body.link for body in cell.capsules_compared)
    lines += [f"compared as capsules: {', '.join(rounded)}"] if rounded else []
    for link in dict.fromkeys(hull.link for hull in cell.hulls):
        own = [hull for hull in cell.hulls if hull.link == link]
        litres = 1e3 * sum(hull_of(np.array(hull.points)).computeVolume() for hull in own)
        around = 1e3 * sum(capsule_volume(each.p0, each.p1, each.radius) for each in cell.bodies if each.link == link)
        corners, margin = sum(len(hull.points) for hull in own), 1e3 * max(hull.radius for hull in own)
        what = "a hull" if len(own) == 1 else f"{len(own)} hulls"
        lines.append(
            f"compared as {what}: {link}, {corners} corners with {margin:.1f} mm around; "
            f"{litres:.2f} l, its capsules {around:.2f} l"
        )
    return lines


def _optional(cell: Cell) -> dict[str, bool]:
    strangers = sorted(
        {*chain(*cell.untouching)} - {*cell.description.links, "world", *(box.name for box in cell.boxes)}
    )
    return {
        "cameras": bool(cell.cameras),
        "a laser scanner": cell.laser is not None,
        "lights": bool(cell.light_names),
        "grippers": bool(cell.devices("gripper")),
        "force-torque sensors": bool(cell.devices("force")),
        "obstacles, such as a floor": bool(cell.obstacles),
        f"the file of poses, {cell.poses}": not cell.poses or Path(cell.poses).is_file(),
        f"links that the SRDF names: {', '.join(strangers)}": not strangers,
    }


if __name__ == "__main__":
    sys.exit(main())
