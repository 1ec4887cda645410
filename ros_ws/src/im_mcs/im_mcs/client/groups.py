"""Groups of all presets, and which of them there are at present."""

from im_core.errors import NotFoundError, StateError
from im_mcs.config import Group, McsConfig


def all_groups(config: McsConfig) -> list[str]:
    """Names of the groups of all presets, in alphabetical order."""
    return sorted({name for groups in config.presets.values() for name in groups})


def group_in_force(config: McsConfig, name: str) -> Group:
    """A group of the preset in force.

    Raises:
        StateError: The group is one of another preset; the message says of which.
        NotFoundError: No preset has such a group.
    """
    if name in config.groups:
        return config.groups[name]
    presets = [preset for preset, groups in config.presets.items() if name in groups]
    if not presets:
        raise NotFoundError(kind="group", name=name, known=config.groups)
    raise StateError(
        f"group '{name}' is not in the preset in force, {config.preset} ({', '.join(config.groups)}), but in"
        f" {' and '.join(presets)}; /mcs/set_partition changes it",
        group=name,
        preset=config.preset,
    )
