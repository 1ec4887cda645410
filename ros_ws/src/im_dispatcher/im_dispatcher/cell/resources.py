"""What the cell has once, so that one command at a time may use it."""

from im_cell.robot import Cell

ZONE = "zone"
"""Where the arms can meet."""

LASER = "laser"


def resources_of(cell: Cell) -> tuple[str, ...]:
    """Returns the names of the resources of a cell: of each side arm, cart, gripper and light, cameras, laser, zone."""
    sides = [f"{side}_{part}" for side in cell.sides for part in ("arm", "cart", "gripper", "led")]
    return (*sides, *cell.cameras, LASER, ZONE)
