"""The first cell file of a URDF: groups, homes, capsules and hulls, asking nothing that the URDF shows."""

import json
import os
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from im_cell.robot import Box, Capsule, Cell, Hull
from im_cell.robot.cell import robot_text
from im_cell.robot.description import UrdfJoint, UrdfTree, parse_description
from im_core.config import faults
from im_core.errors import ConfigError, DataError
from im_core.text.yamltext import write_yaml
from im_mcs.cell.capsules import enclosing_capsules
from im_mcs.cell.hulls import enclosing_hulls
from im_mcs.cell.torques import acceleration_share
from im_mcs.collision.bodies import NEIGHBOURS, Bodies
from im_mcs.inverse import Arm, ArmTracker
from im_mcs.inverse.arm import FEWEST_JOINTS
from im_mcs.model import CellModel

_SAMPLES, _SEED_KEY = 400, 20261127
_ALWAYS = 0.95
_HELD_M, _BUILT_M = 0.08, 0.03
"""Distances of pairs that are always closer and never touch, and the usual one of links two joints apart that may."""
_TOOL = re.compile("tcp|tool|ee|eef|gripper_frame|flange")
_FINGER = re.compile("gripper|finger|jaw", re.IGNORECASE)
_WORD = re.compile(r"[A-Za-z_][\w./-]*", re.ASCII)
_FLOOR = {"link": "world", "size": (4.0, 4.0, 0.1), "center": (0.0, 0.0, -0.05),
          "color": (0.52, 0.50, 0.47)}  # fmt: skip
_JAW_M = 0.1
"""A last sliding joint of a shorter stroke is a jaw, one of a longer stroke an axis, as of a gantry."""
_HOME_MARGIN = 0.2
_SLOWEST, _SPARE = 0.05, 0.95
"""Least share of the assumed acceleration: with less, an arm only seems to move; and the used part of what torques
afford."""
_CLEAR_M = (0.05, 0.02)


def first_cell(urdf: Path, srdf: Path | None = None, folder: Path | None = None) -> str:
    """Return the text of a cell file for a URDF.

    Args:
        urdf: The file.
        srdf: Pairs of links that are not compared (MoveIt's SRDF); None: those that always touch are found.
        folder: Folder of the cell file; None: that of the URDF.

    Raises:
        ConfigError: The URDF or SRDF is missing or wrong, or nothing in it moves.
        DataError: A mesh is missing or in millimetres.
    """
    description = parse_description(robot_text(urdf), str(urdf))
    tips = _tips(description)
    if not tips:
        raise ConfigError(f"{urdf}: no chain of two joints or more moves, so there is no arm", file=str(urdf))
    grouped: dict[str, Sequence[UrdfJoint]] = _chains(description, tips)
    floor = Box.model_validate({**_FLOOR, "name": "ground" if "floor" in description.links else "floor"})
    data = {
        "urdf": str(urdf.absolute()),
        "groups": {
            name: {"tip": joints_tip, "joints": [j.name for j in joints], "home": [_middle(j) for j in joints]}
            for (name, joints), joints_tip in zip(grouped.items(), tips, strict=True)
        },
        "capsules": [{"link": description.root, "p0": (0, 0, 0), "p1": (0, 0, 0.01), "radius": 0.01}],
        "boxes": [floor],
        "srdf": "" if srdf is None else str(srdf.absolute()),
    }
    try:
        bare = Cell.model_validate(data)
    except ValidationError as error:
        raise ConfigError(f"{urdf}: {faults(error, Cell)[0].sentence}", file=str(urdf)) from error
    capsules, hulls = enclosing_capsules(bare), enclosing_hulls(bare)
    cell = bare.model_copy(update={"capsules": tuple(capsules), "hulls": tuple(hulls)})
    never = () if srdf is not None else _never(cell)
    home = _home(cell.model_copy(update={"never": never}))
    slower = _slower(cell)
    files = {
        key: os.path.relpath(file, folder or urdf.parent) for key, file in (("urdf", urdf), ("srdf", srdf)) if file
    }
    return _written(urdf.name, files, grouped, tips, home, slower, capsules, hulls, never, floor)


def _chains(description: UrdfTree, tips: Sequence[str]) -> dict[str, Sequence[UrdfJoint]]:
    of = {joint.child: joint for joint in description.joints}
    taken: set[str] = set()
    found: dict[str, Sequence[UrdfJoint]] = {}
    for number, tip in enumerate(tips, start=1):
        chain, link = list[UrdfJoint](), tip
        while link in of:
            joint = of[link]
            if joint.kind != "fixed" and not joint.mimic and joint.name not in taken:
                chain.insert(0, joint)
            link = joint.parent
        taken |= {joint.name for joint in chain}
        found["arm" if len(tips) == 1 else f"arm_{number}"] = chain
    return found


def _tips(description: UrdfTree) -> list[str]:
    """Return the tool frames: where a chain of joints ends, or the hand that only fingers hang on."""
    below: dict[str, list[UrdfJoint]] = {}
    for joint in description.joints:
        below.setdefault(joint.parent, []).append(joint)

    def depth(link: str) -> int:
        return max((depth(j.child) + (j.kind != "fixed" and not j.mimic) for j in below.get(link, ())), default=0)

    def fixed(link: str) -> list[str]:
        return [f for j in below.get(link, ()) if j.kind == "fixed" for f in (j.child, *fixed(j.child))]

    def walk(link: str, above: int) -> list[str]:
        far = [joint for joint in below.get(link, ()) if depth(joint.child) + (joint.kind != "fixed") > 1]
        fingers = [j for j in below.get(link, ()) if j.kind != "fixed"]
        if len(far) > 1 or (far and not (above > 1 and depth(link) <= 1)):
            return [tip for joint in far for tip in walk(joint.child, above + (joint.kind != "fixed"))]
        deeper = [j for j in below.get(link, ()) if j.kind == "fixed" and depth(j.child) > 0]
        if not fingers and deeper:
            return walk(deeper[0].child, above)
        last = fingers[0] if len(fingers) == 1 and not _is_finger(description, fingers[0], below) else None
        if last is not None:
            return walk(last.child, above + 1)
        if above < 2:
            return []
        named = [frame for frame in fixed(link) if _TOOL.search(frame)]
        return [named[-1] if named else link]

    return walk(description.root, 0)


def _is_finger(description: UrdfTree, joint: UrdfJoint, below: Mapping[str, Sequence[UrdfJoint]]) -> bool:
    """Whether a last joint moves a jaw: by name, by a short stroke, or by a tool frame beside the jaw."""
    beside = [other.child for other in below[joint.parent] if other.kind == "fixed"]
    short = joint.kind == "prismatic" and (joint.upper or 0.0) - (joint.lower or 0.0) < _JAW_M
    return short or bool(_FINGER.search(joint.name)) or any(_TOOL.search(frame) for frame in beside)


def _middle(joint: UrdfJoint) -> float:
    if joint.kind == "continuous" or joint.lower is None or joint.upper is None:
        return 0.0
    return 0.0 if joint.lower < 0.0 < joint.upper else (joint.lower + joint.upper) / 2.0


def samples_of(cell: Cell, margin: float) -> NDArray[np.float64]:
    """Return random positions, a share of the range away from its ends, shape (k, n) [rad or m]."""
    draw = np.random.Generator(np.random.Philox(key=_SEED_KEY)).uniform(size=(_SAMPLES, len(cell.joints)))
    lower, upper = cell.per_joint("limits.lower"), cell.per_joint("limits.upper")
    span = (upper - lower) * margin
    return lower + span + draw * (upper - lower - 2.0 * span)


def _never(cell: Cell) -> list[tuple[str, str]]:
    """Return the pairs of links that are not worth a look: shapes that touch, or are kept close, by construction."""
    bodies = Bodies(CellModel(cell))
    shapes: dict[tuple[str, str], list[int]] = {}
    for pair in range(len(bodies.pairs)):
        shapes.setdefault(bodies.pair_names(pair), []).append(pair)
    distances: dict[tuple[str, str], list[float]] = {names: [] for names in shapes}
    for q in samples_of(cell, 0.0):
        bodies.place(q)
        for names, pairs in shapes.items():
            distances[names].append(min(map(bodies.distance, pairs)))
    return [
        names for names, each in distances.items() if _by_construction(bodies.joints_between(shapes[names][0]), each)
    ]


def _by_construction(joints: int, distances: Sequence[float]) -> bool:
    """Return whether links touch always, never and are held close, or are two joints apart and usually close."""
    held = min(distances) > 0.0 and max(distances) < _HELD_M
    usual = float(np.median(distances))
    return float(np.quantile(distances, _ALWAYS)) <= 0.0 or held or (joints == NEIGHBOURS + 1 and usual < _BUILT_M)


def _home(cell: Cell) -> list[float]:
    """Return positions that are free of collisions and far from singular, among the middle and some others."""
    model = CellModel(cell)
    bodies = Bodies(model)
    tips = [group.tip for group in cell.groups.values() if len(cell.carriers_of(group.tip)) >= FEWEST_JOINTS]
    arms = [ArmTracker(model, Arm(model, tip), tip) for tip in tips]
    best, found, met = 0.0, cell.home, Counter[tuple[str, str]]()
    tried = []
    for q in (cell.home, *samples_of(cell, _HOME_MARGIN)):
        bodies.place(q)
        tried.append((q, bodies.closest()))
    clear_m = next((clear for clear in _CLEAR_M if any(near.distance >= clear for _, near in tried)), np.inf)
    for q, near in tried:
        if near.distance < clear_m:
            met[near.first, near.second] += 1
            continue
        worst = min((arm.singular_value(q) for arm in arms), default=1.0)
        if worst > best:
            best, found = worst, q
    if best == 0.0 and met:
        first, second = met.most_common(1)[0][0]
        text = f"no position of the joints was found that is free of collisions: {first} and {second} meet most often"
        raise DataError(f"{text}; an SRDF (--srdf) names pairs that are not compared", first=first, second=second)
    return [round(float(value), 3) for value in found]


def _slower(cell: Cell) -> dict[str, float]:
    """Return the acceleration of each joint where torques do not afford the assumed one, by joint [rad/s2 or m/s2]."""
    if cell.unknown:
        return {}
    share = float(acceleration_share(cell, samples_of(cell, 0.0)).min())
    if share >= 1.0:
        return {}
    at_once = max(_SPARE * share, _SLOWEST) * cell.per_joint("limits.acceleration")
    return {name: float(f"{value:.2g}") for name, value in zip(cell.joint_names, at_once, strict=True)}


def _written(
    robot: str,
    files: Mapping[str, str],
    grouped: Mapping[str, Sequence[UrdfJoint]],
    tips: Sequence[str],
    home: Sequence[float],
    slower: Mapping[str, float],
    capsules: Sequence[Capsule],
    hulls: Sequence[Hull],
    never: Sequence[tuple[str, str]],
    floor: Box,
) -> str:
    names = [joint.name for joint in _ordered(grouped)]
    at = dict(zip(names, home, strict=True))
    lines = [f"# First cell file of {robot}; `im cell check` says what it leaves open."]
    lines += [*(f"{key}: {_plain(file)}" for key, file in files.items()), "", "groups:"]
    for (name, joints), tip in zip(grouped.items(), tips, strict=True):
        lines += [
            f"  {name}:",
            f"    tip: {_plain(tip)}",
            f"    joints: [{', '.join(_plain(each.name) for each in joints)}]",
        ]
        lines.append(f"    home: [{', '.join(str(at[joint.name]) for joint in joints)}]")
    if slower:
        lines += ["", "drives:                 # accelerations that the torques afford, all joints at once"]
        lines += [f"  {_plain(joint)}: {{acceleration: {value:g}}}" for joint, value in slower.items()]
    lines += ["", "capsules:               # around the shapes of the links"] if capsules else []
    for each in capsules:
        ends = (f"[{', '.join(map(str, end))}]" for end in (each.p0, each.p1))
        lines.append("  - {{link: {}, p0: {}, p1: {}, radius: {:g}}}".format(_plain(each.link), *ends, each.radius))
    if hulls:
        lines += ["", "hulls:                  # around meshes; compared in place of the capsules of their links"]
    for hull in hulls:
        corners = ", ".join(f"[{', '.join(f'{value:g}' for value in point)}]" for point in hull.points)
        lines.append(f"  - {{link: {_plain(hull.link)}, radius: {hull.radius:g}, points: [{corners}]}}")
    if never:
        lines += [
            "",
            "never:                  # pairs of links that are not looked at: they touch or are close by construction",
        ]
        lines += [f"  - [{_plain(first)}, {_plain(second)}]" for first, second in never]
    size, centre, color = (f"[{', '.join(map(str, each))}]" for each in (floor.size, floor.center, floor.color))
    lines += [
        "",
        "boxes:",
        f"  - {{link: world, name: {floor.name}, size: {size}, center: {centre}, color: {color}}}",
        "",
    ]
    return "\n".join(lines)


def _plain(name: str) -> str:
    """Return a name as YAML reads the name back, in quotes where signs, or words such as ``on``, need them."""
    is_plain = _WORD.fullmatch(name) and write_yaml([name]) == f"- {name}\n"
    return name if is_plain else json.dumps(name, ensure_ascii=False)


def _ordered(grouped: Mapping[str, Sequence[UrdfJoint]]) -> list[UrdfJoint]:
    return [joint for joints in grouped.values() for joint in joints]


def touching_pairs(cell: Cell) -> list[tuple[str, str]]:
    """Return the pairs of links or boxes that touch at home."""
    bodies = Bodies(CellModel(cell))
    bodies.place(cell.home)
    return [bodies.pair_names(pair) for pair in range(len(bodies.pairs)) if bodies.distance(pair) <= 0.0]
