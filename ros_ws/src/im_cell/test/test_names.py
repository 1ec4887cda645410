"""Packages above the cell name no part, side or count of the default cell, nor do their nets and settings."""

import re
from pathlib import Path

import pytest

from im_cell.robot import load_cell

SOURCES = Path(__file__).resolve().parents[2]
CELL = load_cell("puma_pair")
PARTS = [name for names in CELL.kinds.values() for name in names]
NAMES = {*CELL.joint_names, *CELL.cameras, *CELL.partitions, *PARTS, *CELL.description.links} - {
    "world", "laser", "left", "right", "table", "wall",
}  # fmt: skip
NAMES |= {f"{group}_{part}" for group in CELL.groups for part in ("arm", "cart")}
NAMED = re.compile(rf"\b({'|'.join(sorted(NAMES))})\b")
#: Sides in quotes or in names of parts, and the number of joints.
SIDE_OR_COUNT = re.compile(
    r"""(?<!side=)["'](left|right)["']|\(18,\)|range\((18|9)\)|[!=<>]= (18|9)\b|:(18|9)\]"""
    r"""|\b(18|9|eighteen|nine) (joints|slots)"""
)


PACKAGES = (
    "im",
    "im_bringup",
    "im_coordinators",
    "im_dispatcher",
    "im_mcs",
    "im_msgs",
    "im_pnt_display",
    "im_sim",
    "im_vss",
)
KINDS = {".py", ".yaml", ".js", ".msg", ".srv", ".action"}


@pytest.mark.parametrize("package", PACKAGES)
def test_no_file_names_a_part_of_the_default_cell(package):
    folder = SOURCES / package
    files = [
        path for path in sorted(folder.rglob("*.*")) if path.suffix in KINDS and not {"test", "vendor"} & {*path.parts}
    ]
    assert files
    found = [
        f"{path.relative_to(folder)}:{number}: {line.strip()}"
        for path in files
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1)
        if NAMED.search(line) or SIDE_OR_COUNT.search(line)
    ]
    assert not found
