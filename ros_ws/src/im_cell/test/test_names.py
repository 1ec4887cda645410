"""Packages above the cell name no part of the default cell, nor do their nets and settings."""

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


@pytest.mark.parametrize("package", ["im_mcs", "im_coordinators", "im_dispatcher", "im_vss"])
def test_no_file_names_a_part_of_the_default_cell(package):
    folder = SOURCES / package
    found = [
        f"{path.relative_to(folder)}:{number}: {line.strip()}"
        for pattern in ("*.py", "*.yaml")
        for path in sorted((folder / package).rglob(pattern))
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1)
        if NAMED.search(line) or "(18,)" in line
    ]
    assert not found
