"""Hand-overs of a part from random places: how many succeed, and how far off the part is at rest, by the truth."""

import json
import math
import os
import random
import subprocess
from pathlib import Path

from geometry_msgs.msg import Point, Pose, Quaternion
from scipy.spatial.transform import Rotation

from bench.chaos.faults import kill
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
#: Farthest from upright that a part is safe, and how far below where it stands [m].
SAFE_DEG, SAFE_M = 5.0, 0.01


def handover_lines(seeds: int, port: int, faults: bool = False) -> list[Line]:
    """Start the machine with its free bodies; hand the part over once for each seed, with or without faults.

    Raises:
        MachineError: The machine does not start.
    """
    os.environ["IM_OBJECTS"] = str(package_file("im_cell", "cells/puma_pair/objects.yaml"))
    with Machine.start(factor=0, seed=SEED, port=port, calibration=CALIBRATION, fresh=True, timeout=START_S) as machine:
        found = [_hand_over(machine, seed, faults) for seed in range(1, seeds + 1)]
    ended = [errors for errors in found if not isinstance(errors, bool)]
    good = [errors for errors in ended if errors[0] <= MOST_MM and errors[1] <= MOST_DEG]
    safe = len(ended) + found.count(True)
    worst = [max((errors[axis] for errors in ended), default=math.nan) for axis in (0, 1)]
    return [
        Line(
            f"{seeds} hand-overs, within {MOST_MM:g} mm and {MOST_DEG:g} degree",
            len(good),
            "",
            bar=math.ceil(SHARE * seeds) if faults else seeds,
            at_least=True,
        ),
        Line("  after which the part stood upright, or was held", safe, "", bar=seeds, at_least=True),
        Line("  largest error at rest of those that succeeded", worst[0], "mm", bar=MOST_MM),
        Line("  about an axis", worst[1], "degrees", bar=MOST_DEG),
    ]


def _hand_over(machine: Machine, seed: int, faults: bool) -> tuple[float, float] | bool:
    """Errors at rest [mm, degrees] of one command, which are told; where it failed, whether the part is safe."""
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
    failure = ""
    try:
        _follow(machine.run("handover", wait=False, name=PART, near=[x, y, UPRIGHT_M + 0.13], to=to), faults, draw)
    except MachineError as error:
        failure = str(error)
    place = json.loads(machine.connection.call(GetTruth, "/testbed/get_truth").json)["objects"][PART]
    turned = Rotation.from_quat(place[3:]).as_euler("ZYX", degrees=True)
    if failure:
        safe = place[2] > UPRIGHT_M - SAFE_M and max(abs(turned[1:])) < SAFE_DEG
        print(f"{told}: {failure}; the part is {'safe' if safe else 'NOT safe'}", flush=True)
        subprocess.run([ROOT / "scripts/im", "recover"], capture_output=True, check=False)
        return bool(safe)
    off = 1e3 * math.dist(place[:3], (*to, UPRIGHT_M))
    about = max(abs((angle + 45.0) % 90.0 - 45.0) for angle in turned.tolist())
    print(f"{told}: {off:.1f} mm, {about:.2f} degrees off", flush=True)
    return off, about


def _follow(order: Command, faults: bool, draw: random.Random) -> object:
    """Return the results of a command; with faults, kill a process in every tenth step."""
    for step, progress in enumerate(order, start=1):
        if faults and step % TENTH == 0:
            fault = kill((draw.choice(VICTIMS),))
            print(f"  step {step}, {progress.message}: {fault}", flush=True)
            fault.inject(lambda: None)
    return order.result
