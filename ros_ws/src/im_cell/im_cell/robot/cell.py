"""The cell: a URDF, the cell file beside it, and derived values."""

import math
import os
import re
from collections.abc import Collection
from functools import cached_property
from pathlib import Path
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationInfo, field_validator, model_validator

from im_cell.robot.description import UrdfGeometry, UrdfJoint, UrdfTree, disabled_pairs, parse_description
from im_cell.robot.objects import ObjectsFile
from im_cell.robot.parameters import (
    Box,
    BrakeSpec,
    Camera,
    Capsule,
    CellGroup,
    CellMount,
    DriveSpec,
    EncoderSpec,
    Gripper,
    Group,
    Hull,
    Led,
    Number,
    Place,
    Size,
    Vector,
    WristSensor,
)
from im_cell.robot.scenery import Lamp, LaserScanner, Mirror, Optics, Target
from im_cell.robot.tree import WORLD, Joint, LinkInertia, Tree, assumptions, joint_of
from im_cell.rotations import matrix_of_rpy
from im_cell.workspace import Workspace
from im_core.config import FieldError, load_model, package_file
from im_core.errors import ConfigError, DataError, nearest, shortened
from im_core.files import MEBIBYTE, FileError, read_text
from im_core.names import CELL, OBJECTS
from im_core.text.yamltext import Location

_GREY = (0.72, 0.73, 0.75)
DEFAULT_CELL = "puma_pair"
_LARGEST_URDF = 8 * MEBIBYTE
_GRIPPER_PARTS = ("gripper", "palm", "jaw", "jaw_1", "jaw_2")
_CLASS, _SAID = re.compile("^<class '[^']*'>: "), 120
_TOPIC = re.compile("[A-Za-z][A-Za-z0-9_]{0,63}")

_SHORTEST_S = 1e-4
"""Shortest tick of the testbed: times are told in whole nanoseconds, and one that is none would let no time pass."""


class Cell(ObjectsFile):
    """Everything known about the cell before calibration.

    >>> cell.home[:3].tolist(), cell.per_joint("limits.torque")[:3].tolist()
    ([-0.6, 0.0, 0.0], [1500.0, 600.0, 900.0])
    >>> cell.at_period(0.009).substeps == 2 * cell.substeps
    True
    """

    urdf: str
    srdf: str = ""
    poses: str = ""
    mount: CellMount = CellMount()
    groups: Annotated[dict[str, CellGroup], Field(min_length=1)]
    presets: dict[str, dict[str, Group]] = Field(default_factory=dict)
    drives: dict[str, DriveSpec] = Field(default_factory=dict)
    standing: dict[str, Number] = Field(default_factory=dict)
    capsules: tuple[Capsule, ...] = ()
    hulls: tuple[Hull, ...] = ()
    never: tuple[tuple[str, str], ...] = ()
    period: Annotated[float, Field(ge=_SHORTEST_S)] = 0.0045
    substeps: Annotated[int, Field(ge=1, le=64)] = 4
    gravity: Number = 9.81
    encoder: EncoderSpec = EncoderSpec(counts_per_turn=4000, noise_counts=0.5)
    brakes: BrakeSpec = BrakeSpec(source="assumed", delay=0.08)
    gripper: Gripper = Gripper()
    wrist_sensor: WristSensor = WristSensor()
    led: Led = Led()
    boxes: tuple[Box, ...] = ()
    workspace: tuple[Place, Place] | None = None
    cameras: dict[str, Camera] = Field(default_factory=dict)
    camera_body: Size = (0.04, 0.04, 0.05)
    optics: Optics = Optics(blur=0.9, vignetting=0.15)
    mirrors: tuple[Mirror, ...] = ()
    lamps: tuple[Lamp, ...] = ()
    laser: LaserScanner | None = None

    @field_validator("workspace")
    @classmethod
    def _has_sides(cls, corners: tuple[Vector, Vector] | None) -> tuple[Vector, Vector] | None:
        if corners is not None:
            try:
                Workspace(*corners)
            except DataError as error:
                raise ValueError(error.message) from error
        return corners

    @property
    def workspace_box(self) -> Workspace | None:
        """Box in which errors of calibrated cameras are given; None: around the places of the light."""
        return None if self.workspace is None else Workspace(*self.workspace)

    @field_validator("urdf", "srdf", "poses")
    @classmethod
    def _found(cls, named: str, info: ValidationInfo) -> str:
        return str(resolved(named, Path(str((info.context or {}).get("file", ""))))) if named else ""

    @model_validator(mode="after")
    def _references(self) -> Self:
        try:
            description, _ = self.description, self.untouching
        except ConfigError as error:
            raise FieldError(("srdf" if error.facts.get("file") == self.srdf else "urdf",), error.message) from None
        self._check_groups(description)
        self._check_joints()
        self._check_frames()
        return self

    def _check_groups(self, description: UrdfTree) -> None:
        """Check names of groups, frames and joints, and the positions at home."""
        joints = {joint.name: joint for joint in description.joints if joint.kind != "fixed"}
        links = (*description.links, WORLD)
        if WORLD in description.links and description.root != WORLD:
            raise FieldError(("urdf",), f"link '{WORLD}' is not its root; no other link may have that name")
        if description.root == WORLD and self.mount != CellMount():
            raise FieldError(("mount",), f"the root of the URDF is '{WORLD}' itself, which stands nowhere else")
        for name in self.drives:
            _require(name, joints, ("drives", name), "a joint of the URDF")
        for name, position in self.standing.items():
            _require(name, joints, ("standing", name), "a joint of the URDF")
            lower, upper = joints[name].lower, joints[name].upper or 0.0
            if lower is not None and joints[name].kind != "continuous" and not lower <= position <= upper:
                raise FieldError(("standing", name), f"{position:g} is outside the range {lower:g} to {upper:g}")
        taken: dict[str, str] = {}
        for name, group in self.groups.items():
            if not _TOPIC.fullmatch(name):
                raise FieldError(("groups", name), f"'{name}' names topics: letters, digits and _, a letter first")
            _require(group.tip, links, ("groups", name, "tip"), "a link of the URDF")
            _require(group.base, links, ("groups", name, "base"), "a link of the URDF")
            for rank, joint in enumerate(group.joints):
                _require(joint, joints, ("groups", name, "joints", rank), "a joint of the URDF")
            moved = self.joints_of(name)
            for carrier in self._between(group.tip):
                if carrier.mimic and carrier.name not in (*self.standing, *group.joints):
                    text = f"joint {carrier.name} carries {group.tip} and follows {carrier.mimic} (mimic)"
                    text = f"{text}: no such joint moves here; standing.{carrier.name} can say where it stands"
                    raise FieldError(("groups", name, "tip"), text)
            for joint in moved:
                if joint in self.standing:
                    raise FieldError(("standing", joint), f"joint {joint} is in group '{name}', and moves")
                if joint in taken:
                    raise FieldError(("groups", name), f"joint {joint} is in group '{taken[joint]}' already")
                if not _TOPIC.fullmatch(joint):
                    text = f"joint '{joint}': ROS takes no such name; letters, digits and _ are allowed, a letter first"
                    raise FieldError(("groups", name), text)
                if joints[joint].mimic:
                    text = f"joint {joint} follows {joints[joint].mimic} (mimic); such joints are in no group"
                    raise FieldError(("groups", name), text)
                taken[joint] = name
            if len(group.home) != len(moved):
                text = f"{len(group.home)} positions for {len(moved)} joints: {', '.join(moved)}"
                raise FieldError(("groups", name, "home"), text)
            parts = [f"{name}_led"] * group.light + [f"{name}_{part}" for part in _GRIPPER_PARTS] * group.gripper
            if same := next((part for part in parts if part in links or part in joints), ""):
                text = f"'{same}' would be a part at its tip, and is in the URDF; the group needs another name"
                raise FieldError(("groups", name), text)
        for preset, groups in self.presets.items():
            for name, part in groups.items():
                where: Location = ("presets", preset, name)
                for rank, joint in enumerate(part.joints):
                    _require(joint, taken, (*where, "joints", rank), "a joint of a group")
                if part.wrist is not None:
                    _require(part.wrist, links, (*where, "wrist"), "a link of the URDF")
                for rank, wrist in enumerate(part.pair or ()):
                    _require(wrist, links, (*where, "pair", rank), "a link of the URDF")

    def _check_joints(self) -> None:
        for given, _ in self.tree.joints:
            if given.kind == "continuous" or self.drive(given.name).range is not None:
                continue
            lower, fault = given.lower, ""
            if lower is None and given.kind == "prismatic":
                fault = "slides without a range"
            elif lower is not None and lower >= (given.upper or 0.0):
                fault = f"has the range {lower:g} to {given.upper or 0.0:g}"
            if fault:
                text = f"joint {given.name} {fault}; drives.{given.name}.range can say one"
                raise FieldError(("urdf",), text)
        limits = {joint.name: joint.limits for joint in self.joints}
        for name, group in self.groups.items():
            for rank, (joint, position) in enumerate(zip(self.joints_of(name), group.home, strict=True)):
                lower, upper = limits[joint].lower, limits[joint].upper
                if not lower <= position <= upper:
                    text = f"{position:g} of {joint} is outside its range, {lower:g} to {upper:g}"
                    raise FieldError(("groups", name, "home", rank), text)
        if not self.capsules:
            for name, link in self.description.links.items():
                for mesh in (shape.mesh for shape in link.shapes if shape.kind == "mesh"):
                    text = f"the shape of link {name} for collision is the mesh {mesh}, and the cell has no capsules"
                    raise FieldError(("urdf",), f"{text}; `im cell new` finds them")

    def _check_frames(self) -> None:
        """Check the parts of the cell: each must be fixed to an existing frame."""
        frames = (WORLD, *self.description.links)
        fixed: list[tuple[Location, str]] = [
            *((("capsules", rank, "link"), each.link) for rank, each in enumerate(self.capsules)),
            *((("hulls", rank, "link"), each.link) for rank, each in enumerate(self.hulls)),
            *((("boxes", rank, "link"), each.link) for rank, each in enumerate(self.boxes)),
            *((("mirrors", rank, "link"), each.link) for rank, each in enumerate(self.mirrors)),
            *((("targets", rank, "parent"), each.parent) for rank, each in enumerate(self.targets)),
            *((("cameras", name, "parent"), each.parent) for name, each in self.cameras.items()),
        ]
        for where, link in fixed:
            _require(link, frames, where, "a link")
        for rank, pair in enumerate(self.never):
            for name in pair:
                _require(
                    name, (*frames, *(box.name for box in self.obstacles)), ("never", rank), "a link or an obstacle"
                )
        lit = [name for name, group in self.groups.items() if group.light]
        for name, camera in self.cameras.items():
            if not _TOPIC.fullmatch(name):
                raise FieldError(("cameras", name), f"'{name}' names topics: letters, digits and _, a letter first")
            if camera.check:
                _require(camera.check.arm, lit, ("cameras", name, "check", "arm"), "a group with a light")
            if f"{name}_body" in frames:
                raise FieldError(("cameras", name), f"'{name}_body' would be its body, and is a link of the URDF")
        names = [*frames]
        for rank, box in enumerate(self.boxes):
            if box.link == WORLD and box.name in names:
                raise FieldError(("boxes", rank, "name"), f"another box, or a link, has the same name, '{box.name}'")
            names += [box.name] * (box.link == WORLD)

    def at_period(self, period: float) -> Self:
        """Return the same cell with another tick [s]; the number of physics steps keeps the step length.

        Raises:
            ConfigError: The period is too short, or needs more steps than allowed.
        """
        if not period >= _SHORTEST_S:
            raise ConfigError(f"a testbed period of {period:g} s is not at least {_SHORTEST_S:g} s", period=period)
        substeps = max(1, round(self.substeps * period / self.period))
        if substeps > 64:
            raise ConfigError(f"a testbed period of {period:g} s is {substeps} physics steps; 64 are allowed")
        return self.model_copy(update={"period": period, "substeps": substeps})

    @cached_property
    def description(self) -> UrdfTree:
        """The robot as the URDF has it.

        Raises:
            ConfigError: The file is missing or no URDF of a tree.
        """
        return parse_description(robot_text(Path(self.urdf)), self.urdf)

    @property
    def untouching(self) -> frozenset[frozenset[str]]:
        """Pairs of links without a comparison, of the cell file and of the SRDF.

        Raises:
            ConfigError: The SRDF is missing or not XML.
        """
        given = frozenset(map(frozenset, self.never))
        return given | disabled_pairs(robot_text(Path(self.srdf)), self.srdf) if self.srdf else given

    @cached_property
    def tree(self) -> Tree:
        """The moving joints and links of the cell, with fixed links."""
        moving = [joint for name in self.groups for joint in self.joints_of(name)]
        return Tree(self.description, moving, self.standing, (self.mount.xyz, self.mount.rpy))

    def drive(self, joint: str) -> DriveSpec:
        """Return the drive of a joint; one that says nothing, where the cell has none."""
        return self.drives.get(joint, DriveSpec())

    def joints_of(self, group: str) -> tuple[str, ...]:
        """Return the names of a group's joints."""
        given = self.groups[group]
        return given.joints or self.carriers_of(given.tip)

    def arm_of(self, group: str) -> tuple[str, ...]:
        """Return the names of the joints between a group's base and its tip."""
        given = self.groups[group]
        below = self.carriers_of(given.base)
        return tuple(joint for joint in self.carriers_of(given.tip) if joint not in below)

    def carriers_of(self, link: str) -> tuple[str, ...]:
        """Return the names of the joints below a link, in order, mimic joints left out."""
        carriers = (each for each in self._between(link) if each.kind != "fixed" and not each.mimic)
        return tuple(joint.name for joint in carriers if joint.name not in self.standing)

    def _between(self, link: str) -> list[UrdfJoint]:
        """Return the joints between the root and a link, in order."""
        found: list[UrdfJoint] = []
        of = {joint.child: joint for joint in self.description.joints}
        while link in of:
            found.insert(0, of[link])
            link = of[link].parent
        return found

    @cached_property
    def joints(self) -> tuple[Joint, ...]:
        """The moving joints in order."""
        return tuple(joint_of(joint, place, self.drive(joint.name), self.encoder) for joint, place in self.tree.joints)

    @cached_property
    def links(self) -> tuple[LinkInertia, ...]:
        """The moving links, each the child of the joint of the same rank."""
        return self.tree.links

    @cached_property
    def assumed(self) -> tuple[str, ...]:
        """Assumptions where URDF and cell file are silent, as sentences."""
        told = list(assumptions(self.tree, self.drives)[1])
        if self.light_names and "offset" not in self.led.model_fields_set:
            place = "({:g}, {:g}, {:g})".format(*self.led.offset)
            told.append(f"no offset of the light (led); it is at {place} m in the frame of the tip")
        if self.devices("gripper"):
            for name, what in (
                ("stroke", "stroke of the gripper"),
                ("reach", "reach of the gripper from the tip to its jaws"),
            ):
                if name not in self.gripper.model_fields_set:
                    told.append(f"no {what}; it is {getattr(self.gripper, name):g} m")
        if self.cameras and self.workspace is None:
            told.append("no workspace; errors of calibrated cameras are given where their light was")
        return tuple(told)

    @cached_property
    def unknown(self) -> tuple[str, ...]:
        """Data that torques would need and neither URDF nor cell file has, as sentences."""
        return tuple(assumptions(self.tree, self.drives)[0])

    @cached_property
    def bodies(self) -> tuple[Capsule, ...]:
        """Collision shapes of all links: those of the file, else around the shapes of the URDF."""
        if self.capsules:
            return self.capsules
        return tuple(around(shape, name) for name, link in self.description.links.items() for shape in link.shapes)

    @property
    def capsules_compared(self) -> tuple[Capsule, ...]:
        """Collision shapes of links without hulls."""
        hulled = {hull.link for hull in self.hulls}
        return tuple(body for body in self.bodies if body.link not in hulled)

    @cached_property
    def obstacles(self) -> tuple[Box, ...]:
        """Boxes fixed to the world, not to be touched by anything."""
        return tuple(box for box in self.boxes if box.collision and box.link == WORLD)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints in order."""
        return tuple(joint.name for joint in self.joints)

    @property
    def home(self) -> NDArray[np.float64]:
        """Where the testbed starts, shape (n,) [rad or m]."""
        at = {
            joint: position
            for name, group in self.groups.items()
            for joint, position in zip(self.joints_of(name), group.home, strict=True)
        }
        return np.array([at[name] for name in self.joint_names])

    @property
    def partitions(self) -> dict[str, dict[str, Group]]:
        """The partitions of the joints: those of the file, else each group alone, and all together."""
        if self.presets:
            return self.presets
        alone = {name: Group(joints=self.joints_of(name), wrist=group.tip) for name, group in self.groups.items()}
        tips = [group.tip for group in self.groups.values()]
        if len(tips) == 1:
            return {"each": alone}
        pair = (tips[0], tips[1]) if len(tips) == 2 else None
        return {"each": alone, "all": {"all": Group(joints=self.joint_names, pair=pair)}}

    def devices(self, kind: str) -> dict[str, str]:
        """Return the tips that have a ``gripper``, a ``force`` sensor or a ``light``, by the device's name."""
        suffix = "led" if kind == "light" else kind
        return {f"{name}_{suffix}": group.tip for name, group in self.groups.items() if getattr(group, kind)}

    def color_of(self, link: str) -> Vector:
        """Return the colour of a moving link, by the first group with a joint that carries the link."""
        carriers = {joint.child: joint.name for joint in self.joints}
        moved = carriers.get(link, "")
        return next((g.color for n, g in self.groups.items() if moved in self.joints_of(n)), _GREY)

    def board_of(self, group: str) -> Target:
        """Return the chessboard that an arm carries.

        Raises:
            ConfigError: It carries none.
        """
        tip = self.groups[group].tip
        for target in self.targets:
            if target.kind == "chessboard" and target.parent == tip:
                return target
        told = f"the {group} arm carries no chessboard; targets of the cell, or of the file that {OBJECTS} names"
        raise ConfigError(f"{told}, can have one with parent: {tip}", group=group)

    @property
    def scanner(self) -> LaserScanner:
        """The laser scanner.

        Raises:
            ConfigError: The cell has none.
        """
        if self.laser is None:
            raise ConfigError("the cell has no laser scanner")
        return self.laser

    def reach_of(self, group: str) -> float:
        """Return the way from a group's tip along its z axis to the middle of the jaws, 0 without a gripper [m]."""
        return self.gripper.reach if self.groups[group].gripper else 0.0

    @property
    def kinds(self) -> dict[str, list[str]]:
        """Names of the parts by kind, in the order of the file; a kind without parts is empty."""
        devices = {f"{kind}s": list(self.devices(kind)) for kind in ("gripper", "force", "light")}
        scanners = ["laser"] if self.laser else []
        return {"arms": list(self.groups), **devices, "cameras": list(self.cameras), "lasers": scanners}

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the parts, and of the kinds that there are, as ``lights``: needs of tasks are among the names."""
        found = {kind: names for kind, names in self.kinds.items() if names}
        return (*found, *(name for names in found.values() for name in names))

    @property
    def light_names(self) -> tuple[str, ...]:
        """Names of the wrist lights, in the order of the testbed link."""
        return tuple(self.devices("light"))

    def per_joint(self, attribute: str) -> NDArray[np.float64]:
        """One attribute of each joint (``rotor_inertia``, ``limits.torque``, ...), shape (n,)."""
        values: list[object] = list(self.joints)
        for part in attribute.split("."):
            values = [getattr(value, part) for value in values]
        return np.array(values, dtype=np.float64)


def around(shape: UrdfGeometry, link: str) -> Capsule:
    """Return the capsule around a box, cylinder or sphere of a link."""
    turn, origin = matrix_of_rpy(shape.rpy), np.array(shape.xyz)
    if shape.kind == "sphere":
        axis, half, radius = np.array([0.0, 0.0, 1.0]), 1e-4, shape.size[0]
    elif shape.kind == "cylinder":
        axis, half, radius = np.array([0.0, 0.0, 1.0]), shape.size[1] / 2.0, shape.size[0]
    else:
        along = int(np.argmax(shape.size))
        across = [edge for rank, edge in enumerate(shape.size) if rank != along]
        axis, half, radius = np.eye(3)[along], shape.size[along] / 2.0, math.hypot(*across) / 2.0
    ends = [tuple((origin + turn @ (sign * half * axis)).tolist()) for sign in (-1.0, 1.0)]
    return Capsule.model_validate({"link": link, "p0": ends[0], "p1": ends[1], "radius": radius})


def _require(name: str, known: Collection[str], where: Location, what: str) -> None:
    if name not in known:
        raise FieldError(where, f"'{name}' is not {what}{nearest(name, tuple(known))}")


def resolved(named: str, beside: Path) -> Path:
    """Return the path of a URDF or mesh: absolute, beside another file, or in a package of ROS.

    Args:
        named: As written; `package://` begins one in a package, `file://` an absolute one.
        beside: File that names it; the folders above it are looked at too where a package is not installed.

    Raises:
        ValueError: The package is not there.
    """
    if not named.startswith("package://"):
        return beside.parent / named.removeprefix("file://")
    package, _, below = named.removeprefix("package://").partition("/")
    installed = [
        Path(prefix) / "share" for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix
    ]
    for folder in (*installed, *beside.absolute().parents):
        if (path := folder / package / below).is_file():
            return path
    raise ValueError(f"package {package} with '{below}' is in no workspace that is sourced, and in no folder above")


def robot_text(path: Path) -> str:
    """Return the text of a URDF or SRDF, of a `.xacro` file expanded.

    Raises:
        ConfigError: The file cannot be read or expanded.
    """
    if path.suffix == ".xacro":
        import xacro  # takes its time, and few cells have one

        try:
            return str(xacro.process_file(str(path)).toxml())
        except Exception as error:  # of any kind: macros run expressions
            told = " ".join(_CLASS.sub("", str(error)).split())
            raise ConfigError(f"{path}: xacro cannot expand it: {shortened(told, _SAID)}", file=str(path)) from error
    try:
        return read_text(path, _LARGEST_URDF)
    except FileError as error:
        raise ConfigError(error.message, file=str(path)) from error


def shipped_cells() -> tuple[str, ...]:
    """Return the names of the shipped cells."""
    folder = package_file("im_cell", f"cells/{DEFAULT_CELL}/cell.yaml").parents[1]
    return tuple(sorted(path.parent.name for path in folder.glob("*/cell.yaml")))


def cell_file(named: Path | str) -> Path:
    """Return the file of a cell, named as a shipped one or as a path.

    Raises:
        ConfigError: It is a name, and no cell is shipped under it; or it is a URDF.
    """
    path = Path(named)
    if path.suffix in (".urdf", ".xacro"):
        raise ConfigError(f"{path}: a URDF is no cell file; `im cell new {path} --output cell.yaml` writes one of it")
    if path.exists() or path.suffix or path.name != str(named):
        return path
    if path.name not in (known := shipped_cells()):
        raise ConfigError(f"there is no cell '{named}', neither a file nor a shipped one{nearest(path.name, known)}")
    return package_file("im_cell", f"cells/{path.name}/cell.yaml")


def load_cell(path: Path | str | None = None) -> Cell:
    """Read a cell file.

    Args:
        path: The file, or the name of a shipped cell; None: what the environment variable ``IM_CELL`` names, else the
            default one, with the free bodies and further plates of the file named by ``IM_OBJECTS``, if there is one.

    Raises:
        ConfigError: The file or its URDF is missing or wrong; the message names file, line and value.

    >>> load_cell("nowhere.yaml")
    Traceback (most recent call last):
    im_core.errors.ConfigError: nowhere.yaml: cannot be read: No such file or directory
    """
    cell = load_model(cell_file(path or os.environ.get(CELL) or DEFAULT_CELL), Cell)
    if path is None and (beside := os.environ.get(OBJECTS)):
        added = load_model(Path(beside), ObjectsFile)
        taken, frames = {each.name for each in cell.targets}, (WORLD, *cell.description.links)
        for target in added.targets:
            if target.parent not in frames:
                raise ConfigError(f"{beside}: parent of {target.name}: '{target.parent}' is no link of the cell")
            if target.name in taken:
                raise ConfigError(f"{beside}: the cell has a target of the name '{target.name}' already")
        targets, poses = (*cell.targets, *added.targets), added.board_poses or cell.board_poses
        cell = cell.model_copy(update={"objects": added.objects, "targets": targets, "board_poses": poses})
    return cell
