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


@pytest.mark.parametrize("package", ["im_mcs", "im_coordinators", "im_dispatcher", "im_vss"])
def test_no_file_names_a_part_of_the_default_cell(package):
    folder = SOURCES / package
    found = [
        f"{path.relative_to(folder)}:{number}: {line.strip()}"
        for pattern in ("*.py", "*.yaml")
        for path in sorted((folder / package).rglob(pattern))
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1)
        if NAMED.search(line) or SIDE_OR_COUNT.search(line)
    ]
    assert not found
