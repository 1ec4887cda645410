"""Allocation of slots to groups (paper, section 4: "allocate resources and prevent contention")."""

from collections.abc import Mapping, Sequence

from im_core.errors import NotFoundError, StateError


class Reservations:
    """Which group owns which slot.

    Args:
        groups: Slots of every group that may be reserved.
    """

    def __init__(self, groups: Mapping[str, Sequence[str]]) -> None:
        self._groups = {name: tuple(slots) for name, slots in groups.items()}
        self._owners: dict[str, str] = {}

    @property
    def groups(self) -> tuple[str, ...]:
        """Reserved groups, in the order in which they were reserved."""
        return tuple(dict.fromkeys(self._owners.values()))

    def reserve(self, group: str) -> None:
        """Give all slots of ``group`` to it, or none.

        Raises:
            NotFoundError: No such group.
            StateError: The group is reserved already, or a slot belongs to another group; both are named.
        """
        slots = self._slots(group)
        if group in self.groups:
            raise StateError(f"group '{group}' is reserved already", group=group)
        for slot in slots:
            owner = self._owners.get(slot)
            if owner is not None:
                raise StateError(
                    f"group '{group}' cannot be reserved: slot '{slot}' is owned by group '{owner}'",
                    slot=slot,
                    owner=owner,
                    group=group,
                )
        self._owners.update(dict.fromkeys(slots, group))

    def release(self, group: str) -> None:
        """Free the slots of ``group``.

        Raises:
            NotFoundError: No such group.
            StateError: The group is not reserved.
        """
        self.require(group)
        self._owners = {slot: owner for slot, owner in self._owners.items() if owner != group}

    def release_all(self) -> None:
        """Free every slot."""
        self._owners.clear()

    def require(self, group: str) -> None:
        """Check that ``group`` is reserved.

        Raises:
            NotFoundError: No such group.
            StateError: It is not reserved; the message names those that are.
        """
        self._slots(group)
        if group not in self.groups:
            reserved = ", ".join(self.groups) or "none"
            raise StateError(f"group '{group}' is not reserved (reserved: {reserved})", group=group)

    def _slots(self, group: str) -> tuple[str, ...]:
        if group not in self._groups:
            raise NotFoundError(kind="group", name=group, known=sorted(self._groups))
        return self._groups[group]
