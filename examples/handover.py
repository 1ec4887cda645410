"""Find a part, hand it from one arm to the other, and leave a strip of images and a time line.

The cell needs its free bodies, and a calibrated camera on the left wrist: `scripts/demo.sh --mission handover`.
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from im import Machine, Picture

MOST_IMAGES = 8


def draw(moments: list[tuple[str, Picture]], path: Path) -> None:
    """Draw images of some moments above the times of all steps; the last moment is the end."""
    begin = moments[0][1].stamp
    seconds = np.array([picture.stamp - begin for _, picture in moments])
    shown = np.unique(np.linspace(0, len(moments) - 1, MOST_IMAGES).round().astype(int))
    figure = Figure(figsize=(2.6 * len(shown), 2.4 + 0.2 * len(moments)), layout="constrained")
    strip, line = figure.subfigures(2, 1, height_ratios=[2.4, 0.2 * len(moments)])
    for rank, axes in zip(shown, strip.subplots(1, len(shown)), strict=True):
        axes.imshow(moments[rank][1], cmap="gray")
        axes.set_title(f"{seconds[rank]:.1f} s: {moments[rank][0]}", fontsize=7, wrap=True)
        axes.set_axis_off()
    axes = line.subplots()
    axes.barh([words for words, _ in moments[:-1]], np.diff(seconds), left=seconds[:-1])
    axes.invert_yaxis()
    axes.set_xlabel("testbed time [s]")
    axes.tick_params(axis="y", labelsize=7)
    figure.savefig(path, dpi=120)


parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--part", default="part", help="free body of the cell, with a fiducial")
parser.add_argument("--camera", default="table", help="that takes the images")
parser.add_argument("--output", type=Path, default=Path(), help="folder for handover.png")
options = parser.parse_args()

with Machine.connect() as im:
    camera = im.camera(options.camera)
    seen: list[tuple[str, Picture]] = []
    for progress in im.run("handover", wait=False, name=options.part):
        if progress.message and (not seen or progress.message != seen[-1][0]):
            print(progress)
            seen.append((progress.message, camera.snap()))
    seen.append(("set down", camera.snap()))
    named = [(f"{rank}. {words}", picture) for rank, (words, picture) in enumerate(seen, start=1)]
    draw(named, options.output / "handover.png")
    print("strip and time line:", options.output / "handover.png")
