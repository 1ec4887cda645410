"""Hand-overs of a part from random places: how many succeed, and how far off the part is at rest, by the truth."""

import json
import math
import os
import random
import subprocess
from dataclasses import dataclass
from pathlib import Path

from geometry_msgs.msg import Point, Pose, Quaternion
from scipy.spatial.transform import Rotation

from bench.chaos.faults import kill
from bench.chaos.trial import SAYS
from bench.figures import Line
from im import Command, Machine, MachineError
from im_core.config import package_file
from im_msgs.srv import GetTruth, PlaceObject

PART, UPRIGHT_M = "part", 0.88
ROOT = Path(__file__).resolve().parents[2]
#: Testbed's seed of the shipped calibration of the camera on the left wrist.
SEED, CALIBRATION = 3, ROOT / "test/data/wrist_left"
#: Where the part stands, and where it is to stand: ranges of x and y [m]; and how far it is turned at most [rad].
FROM, TO, TURN = ((-0.35, 0.0), (1.0, 1.15)), ((0.45, 0.6), (0.95, 1.08)), 0.6
START_S = 300.0
MOST_MM, MOST_DEG = 3.0, 1.0
#: With faults, one of these is killed in every tenth step; so many of the hand-overs are to succeed all the same.
VICTIMS = (
    "dispatcher", "motion_coordinator", "vision_coordinator", "path_planning_coordinator", "gripper_coordinator", "vss",
    "cameras",
)  # fmt: skip
TENTH, SHARE = 10, 0.9
#: Of these one is killed once, in one of so many steps from the first time on at which an arm holds the part.
MOTION, STEPS = ("mcs", "servo"), range(12, 60)
#: Farthest from upright that a part is safe, and how far below where it stands [m].
SAFE_DEG, SAFE_M = 5.0, 0.01


@dataclass(frozen=True)
class Ended:
    """End of a hand-over.

    Attributes:
        off_mm: How far from where it should be the part is at rest; None: the command failed.
        about_deg: How far it is turned about an axis, 0 where the command failed.
        safe: Whether the part stands, or is held, upright.
        told: Whether the reason of a failure names what was killed; True where nothing failed.
    """

    off_mm: float | None
    about_deg: float = 0.0
    safe: bool = True
    told: bool = True

    @property
    def good(self) -> bool:
        """Whether the part is where it should be."""
        return self.off_mm is not None and self.off_mm <= MOST_MM and self.about_deg <= MOST_DEG


def handover_lines(seeds: int, port: int, victims: tuple[str, ...] = ()) -> list[Line]:
    """Start the machine with its free bodies; hand the part over once for each seed, with or without faults.

    Args:
        seeds: How many, from 1.
        port: Of the display.
        victims: Who is killed: of :data:`MOTION` one once, of others one in every tenth step.

    Raises:
        MachineError: The machine does not start.
    """
    os.environ["IM_OBJECTS"] = str(package_file("im_cell", "cells/puma_pair/objects.yaml"))
    with Machine.start(factor=0, seed=SEED, port=port, calibration=CALIBRATION, fresh=True, timeout=START_S) as machine:
        found = [_hand_over(machine, seed, victims) for seed in range(1, seeds + 1)]
    errors = [(end.off_mm, end.about_deg) for end in found if end.off_mm is not None]
    worst = [max((each[axis] for each in errors), default=math.nan) for axis in (0, 1)]
    bar = {MOTION: 0, (): seeds}.get(victims, math.ceil(SHARE * seeds))
    named = f"{seeds} hand-overs, within {MOST_MM:g} mm and {MOST_DEG:g} degree"
    return [
        Line(named, sum(end.good for end in found), "", bar=bar, at_least=True),
        Line(
            "  after which the part stood upright, or was held",
            sum(end.safe for end in found),
            "",
            bar=seeds,
            at_least=True,
        ),
        Line(
            "  that succeeded, or named what was killed", sum(end.told for end in found), "", bar=seeds, at_least=True
        ),
        Line("  largest error at rest of those that succeeded", worst[0], "mm", bar=MOST_MM),
        Line("  about an axis", worst[1], "degrees", bar=MOST_DEG),
    ]


def _hand_over(machine: Machine, seed: int, victims: tuple[str, ...]) -> Ended:
    """Hand the part over once, and tell how that ended."""
    draw = random.Random(seed)
    (x, y), to, turn = ([draw.uniform(*each) for each in place] for place in (FROM, TO, ((-TURN, TURN),)))
    for group in ("left", "right"):
        machine.run("home", group=group)
    pose = Pose(
        position=Point(x=x, y=y, z=UPRIGHT_M),
        orientation=Quaternion(z=math.sin(turn[0] / 2.0), w=math.cos(turn[0] / 2.0)),
    )
    machine.connection.call(PlaceObject, "/testbed/place_object", name=PART, pose=pose)
    begin = f"({x:.3f}, {y:.3f}) m, {math.degrees(turn[0]):.0f} degrees"
    told = f"hand-over {seed} from {begin}, to ({to[0]:.3f}, {to[1]:.3f}) m"
    failure, killed = "", list[str]()
    try:
        order = machine.run("handover", wait=False, name=PART, near=[x, y, UPRIGHT_M + 0.13], to=to)
        _follow(order, victims, draw, killed)
    except MachineError as error:
        failure = str(error)
    place = json.loads(machine.connection.call(GetTruth, "/testbed/get_truth").json)["objects"][PART]
    turned = Rotation.from_quat(place[3:]).as_euler("ZYX", degrees=True)
    if failure:
        safe = place[2] > UPRIGHT_M - SAFE_M and max(abs(turned[1:])) < SAFE_DEG
        words = [word for victim in killed for word in SAYS.get(victim, (victim,))]
        true = any(word in failure.lower() for word in words)
        named = "" if true else ", the reason NOT true"
        print(f"{told}: {failure}; the part is {'safe' if safe else 'NOT safe'}{named}", flush=True)
        subprocess.run([ROOT / "scripts/im", "recover"], capture_output=True, check=False)
        return Ended(None, safe=bool(safe), told=true)
    along = [1e3 * (there - wanted) for there, wanted in zip(place[:3], (*to, UPRIGHT_M), strict=True)]
    off = math.hypot(*along)
    about = max(abs((angle + 45.0) % 90.0 - 45.0) for angle in turned.tolist())
    axes = ", ".join(f"{each:.1f}" for each in along)
    print(f"{told}: {off:.1f} mm ({axes}), {about:.2f} degrees off", flush=True)
    return Ended(off, about)


def _follow(order: Command, victims: tuple[str, ...], draw: random.Random, killed: list[str]) -> object:
    """Return the results of a command; kill processes meanwhile, and note which."""
    once = draw.choice(STEPS) if victims == MOTION else 0
    for step, progress in enumerate(order, start=1):
        if victims and (step == once if once else step % TENTH == 0):
            killed.append(draw.choice(victims))
            fault = kill((killed[-1],))
            print(f"  step {step}, {progress.message}: {fault}", flush=True)
            fault.inject(lambda: None)
    return order.result
