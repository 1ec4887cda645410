"""Packages above the cell name no joint, arm, camera or partition of the default cell."""

import re
from pathlib import Path

import pytest

from im_cell.robot import load_cell

SOURCES = Path(__file__).resolve().parents[2]
CELL = load_cell("puma_pair")
NAMES = {*CELL.joint_names, *CELL.cameras, *CELL.partitions, *CELL.parts, *CELL.description.links} - {
    "world", "laser", "left", "right", "table", "wall",
}  # fmt: skip
NAMES |= {f"{group}_{part}" for group in CELL.groups for part in ("arm", "cart")}
NAMED = re.compile(rf"\b({'|'.join(sorted(NAMES))})\b")
#: Files of the shipped commands, which are for this cell.
OF_THE_CELL = {"im_dispatcher/job.py"}


@pytest.mark.parametrize("package", ["im_mcs", "im_coordinators", "im_dispatcher", "im_vss"])
def test_no_python_file_names_a_part_of_the_default_cell(package):
    folder = SOURCES / package
    found = [
        f"{path.relative_to(folder)}:{number}: {line.strip()}"
        for path in sorted((folder / package).rglob("*.py"))
        if str(path.relative_to(folder)) not in OF_THE_CELL
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1)
        if NAMED.search(line) or "(18,)" in line
    ]
    assert not found


def test_the_configuration_of_mcs_names_no_part_of_a_cell():
    text = (SOURCES / "im_mcs/im_mcs/config/mcs.yaml").read_text(encoding="utf-8")
    assert not NAMED.search(text)
