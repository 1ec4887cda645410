"""Allocation of slots to groups (paper, section 4: "allocate resources and prevent contention")."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from im_core.errors import NotFoundError, StateError
from im_mcs.protocol.requests import NOBODY, Sender


@dataclass
class Reservation:
    """Group with the slots.

    Attributes:
        group: Name of the group.
        owner: Whose it is, by name; empty: anyone may use it.
        client: The process that reserved it for that owner; empty: not known.
        lease_s: Testbed time after which it lapses unless renewed [s]; 0: never.
        until_ns: When that is, testbed time [ns].
        lapsed: Whether it has; the group then takes no motions until its owner renews the lease.
    """

    group: str
    owner: str
    lease_s: float
    until_ns: int
    lapsed: bool = False
    client: str = ""

    def serves(self, sender: Sender) -> bool:
        """Return whether the sender is the owner: by name, or as the process of the reservation."""
        known = bool(self.client) and self.client == sender.client
        named = _plain(self.owner) in map(_plain, sender.names)
        return known or named or self.owner == ""

    @property
    def who(self) -> str:
        """Group and owner, for messages."""
        return f"group '{self.group}'" + (f" (owner '{self.owner}')" if self.owner else "")

    def left_s(self, now_ns: int) -> float:
        """Return the rest of the lease [s]; 0 if there is none."""
        return max(0.0, (self.until_ns - now_ns) * 1e-9) if self.lease_s > 0.0 else 0.0


class Reservations:
    """Owners of the slots: groups, clients, and the ends of the leases.

    Args:
        groups: Slots of every group that may be reserved.
    """

    def __init__(self, groups: Mapping[str, Sequence[str]]) -> None:
        self._groups = {name: tuple(slots) for name, slots in groups.items()}
        self._held: dict[str, Reservation] = {}

    @property
    def groups(self) -> tuple[str, ...]:
        """Reserved groups, in the order of the reservation."""
        return tuple(self._held)

    def of(self, group: str) -> Reservation | None:
        """Return the reservation of a group, if there is one."""
        return self._held.get(group)

    def reserve(
        self, group: str, owner: str = "", lease_s: float = 0.0, now_ns: int = 0, sender: Sender = NOBODY
    ) -> None:
        """Reserve all slots of ``group`` for the owner, or none.

        Args:
            group: Name of the group.
            owner: Who uses it; empty: anyone.
            lease_s: Testbed time until it lapses unless renewed [s]; 0: never.
            now_ns: Testbed time [ns].
            sender: Who reserves it.

        Raises:
            NotFoundError: No such group.
            StateError: The group is reserved already, or a slot belongs to another group; both sides are named.
        """
        slots = self._slots(group)
        wanted = Reservation(group, owner, lease_s, now_ns + round(lease_s * 1e9), client=sender.client)
        if (present := self._held.get(group)) is not None:
            by = f" by owner '{present.owner}'" if present.owner else ""
            raise StateError(f"group '{group}' is reserved already{by}", group=group, owner=present.owner)
        for other in self._held.values():
            for slot in slots:
                if slot in self._groups[other.group]:
                    raise StateError(
                        f"{wanted.who} cannot be reserved: slot '{slot}' is owned by {other.who}",
                        slot=slot,
                        owner=other.group,
                        group=group,
                    )
        self._held[group] = wanted

    def take_over(self, group: str, owner: str, lease_s: float, now_ns: int, sender: Sender) -> str:
        """Give a reserved group to another owner, from any owner; arguments as :meth:`reserve`.

        Returns:
            Whose it was.

        Raises:
            NotFoundError: No such group.
            StateError: The group is not reserved.
        """
        self.require(group)
        before = self._held.pop(group).owner
        self.reserve(group, owner, lease_s, now_ns, sender)
        return before

    def release(self, group: str) -> None:
        """Free the slots of ``group``.

        Raises:
            NotFoundError: No such group.
            StateError: The group is not reserved.
        """
        self.require(group)
        del self._held[group]

    def release_all(self) -> None:
        """Free every slot."""
        self._held.clear()

    def disposes(self, group: str, sender: Sender) -> bool:
        """Return whether a group is reserved, and the sender may change the group."""
        return group in self._held and self._held[group].serves(sender)

    def renew(self, owner: str, now_ns: int) -> None:
        """Restart every lease of an owner; an expired one holds again.

        Raises:
            StateError: The owner has reserved nothing; those who have are named.
        """
        mine = [r for r in self._held.values() if _plain(r.owner) == _plain(owner)]
        if not mine:
            owners = ", ".join(f"'{name}'" for name in sorted({r.owner for r in self._held.values() if r.owner}))
            raise StateError(f"owner '{owner}' has reserved no group (owners: {owners or 'none'})", owner=owner)
        for reservation in mine:
            reservation.until_ns = now_ns + round(reservation.lease_s * 1e9)
            reservation.lapsed = False

    def lapse(self, now_ns: int) -> list[Reservation]:
        """Return one owner's reservations with a lease newly expired; call again for another owner's."""
        gone = [r for r in self._held.values() if r.lease_s > 0.0 and not r.lapsed and now_ns > r.until_ns]
        if not gone:
            return gone
        gone = [reservation for reservation in gone if reservation.owner == gone[0].owner]
        for reservation in gone:
            reservation.lapsed = True
        return gone

    def has_lapsed(self, group: str, now_ns: int) -> bool:
        """Return whether the lease of a reserved group has expired."""
        reservation = self._held[group]
        return reservation.lapsed or (reservation.lease_s > 0.0 and now_ns > reservation.until_ns)

    def require(self, group: str) -> None:
        """Check whether ``group`` is reserved.

        Raises:
            NotFoundError: No such group.
            StateError: It is not reserved; the message names those that are.
        """
        self._slots(group)
        if group not in self._held:
            reserved = ", ".join(self._held) or "none"
            raise StateError(f"group '{group}' is not reserved (reserved: {reserved})", group=group)

    def require_owner(self, group: str, sender: Sender) -> None:
        """Check whether ``group`` is reserved, and the sender may change the group.

        Raises:
            NotFoundError: No such group.
            StateError: It is not reserved, or it is reserved for another owner, who is named.
        """
        self.require(group)
        if not (reservation := self._held[group]).serves(sender):
            owner, given = reservation.owner, ", ".join(f"'{name}'" for name in sender.names)
            raise StateError(
                f"group '{group}' is driven by its owner '{owner}' only, not by {given or 'a client without a name'};"
                " an operator may take it over (/mcs/take_over)",
                group=group,
                owner=owner,
            )

    def require_driver(self, group: str, sender: Sender) -> None:
        """Check whether ``group`` is reserved, the lease holds, and the sender may move the group.

        Raises:
            NotFoundError: No such group.
            StateError: As :meth:`require_owner`, or the lease has lapsed.
        """
        self.require_owner(group, sender)
        reservation = self._held[group]
        if reservation.lapsed:
            raise StateError(
                f"the lease of {reservation.who} has lapsed; its owner must renew it first",
                group=group,
                owner=reservation.owner,
            )

    def heirs(self, groups: Mapping[str, Sequence[str]], preset: str, sender: Sender) -> dict[str, list[str]]:
        """Return the groups of another partition that take over slots of reserved groups, each with these.

        A group that has the same slots there stays as it is, and is not among them.

        Args:
            groups: Slots of each group of the other partition.
            preset: Its name, for messages.
            sender: Who asks.

        Raises:
            StateError: A group takes over some slots that are reserved and some that are not, or of several owners; or
                the sender may not drive a group that ends.
        """
        lost = [group for group in self._held if tuple(groups.get(group, ())) != self._groups[group]]
        for group in lost:
            self.require_driver(group, sender)
        whose = {slot: group for group in lost for slot in self._groups[group]}
        heirs: dict[str, list[str]] = {}
        for heir, slots in groups.items():
            former = list(dict.fromkeys(whose[slot] for slot in slots if slot in whose))
            named = ", ".join(f"'{group}'" for group in former)
            why = ""
            if former and (free := [slot for slot in slots if slot not in whose]):
                why = f"group '{heir}' has {free[0]} there, too, which is not"
            elif len({_plain(self._held[group].owner) for group in former}) > 1:
                why = f"for several owners, and together group '{heir}' there"
            if why:
                sentence = f"repartition to {preset} is refused: {named} reserved, and {why}; release first"
                raise StateError(sentence, groups=former, preset=preset)
            if former:
                heirs[heir] = former
        if unused := [slot for slot in whose if not any(slot in groups[heir] for heir in heirs)]:
            sentence = f"repartition to {preset} is refused: {unused[0]} is reserved, and in no group there"
            raise StateError(sentence, slot=unused[0], preset=preset)
        return heirs

    def repartition(self, groups: Mapping[str, Sequence[str]], heirs: Mapping[str, Sequence[str]]) -> None:
        """Another set of groups; reservations stay, or go to the heirs with the lease that ends first."""
        self._groups = {name: tuple(slots) for name, slots in groups.items()}
        before = dict(self._held)
        for group in {group for former in heirs.values() for group in former}:
            del self._held[group]
        for heir, former in heirs.items():
            first = min(
                (before[group] for group in former), key=lambda held: held.until_ns if held.lease_s else math.inf
            )
            self._held[heir] = replace(first, group=heir)

    def _slots(self, group: str) -> tuple[str, ...]:
        if group not in self._groups:
            raise NotFoundError(kind="group", name=group, known=sorted(self._groups))
        return self._groups[group]


def _plain(name: str) -> str:
    """Return a name without the leading slash of node names."""
    return name.removeprefix("/")
