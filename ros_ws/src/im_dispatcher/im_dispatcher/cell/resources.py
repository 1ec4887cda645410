"""Resources of the cell: one command at a time uses each."""

from im_cell.robot import Cell

ZONE = "zone"
"""Where the arms can meet."""

LASER = "laser"


def resources_of(cell: Cell) -> tuple[str, ...]:
    """Return the resources of a cell: arm, cart, gripper and light of each side, cameras, laser, zone."""
    sides = [f"{side}_{part}" for side in cell.sides for part in ("arm", "cart", "gripper", "led")]
    return (*sides, *cell.cameras, LASER, ZONE)
