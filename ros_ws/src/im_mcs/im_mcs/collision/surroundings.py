"""Free bodies for the collision watch to keep away from, and contacts allowed for a time."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, Self

from pydantic import Field, ValidationError, field_validator

from im_cell.robot.objects import MAX_BODIES
from im_cell.rotations import UNIT_TOLERANCE
from im_core.config import Model, faults
from im_core.errors import DataError, NotFoundError

#: Longest lease of an allowed contact [s].
LONGEST_CONTACT_S = 60.0
#: Largest edge of a free body [m].
_LARGEST_M = 5.0
_MOST_CONTACTS = 32

_Edge = Annotated[float, Field(gt=0, le=_LARGEST_M)]
Text = Annotated[str, Field(min_length=1, max_length=64)]


class Thing(Model):
    """Free body at its place: on the table, or in the jaws.

    Attributes:
        name: What it is.
        kind: ``box`` or ``cylinder``, upright along z.
        size: Edge lengths; of a cylinder diameter, diameter and height [m].
        frame: ``world``, or the wrist that carries it.
        pose: Of its middle there: position [m] and quaternion x, y, z, w, shape (7,).
    """

    name: Text
    kind: Literal["box", "cylinder"]
    size: tuple[_Edge, _Edge, _Edge]
    frame: Text
    pose: Annotated[tuple[float, ...], Field(min_length=7, max_length=7)]

    @field_validator("pose")
    @classmethod
    def _turned(cls, pose: tuple[float, ...]) -> tuple[float, ...]:
        if abs(math.hypot(*pose[3:]) - 1.0) > UNIT_TOLERANCE:
            raise ValueError("x y z [m] and a quaternion x y z w of norm 1 are needed")
        if max(map(abs, pose[:3])) > 100.0:
            raise ValueError("the position is beyond 100 m")
        return pose

    @classmethod
    def checked(cls, name: str, kind: str, size: Sequence[float], frame: str, pose: Sequence[float]) -> "Thing":
        """Return a thing from the data of a request.

        Raises:
            DataError: A value is out of range; it is named.
        """
        given = {"name": name, "kind": kind, "size": size, "frame": frame, "pose": pose}
        try:
            return cls.model_validate(given)
        except ValidationError as error:
            fault = faults(error, cls)[0]
            told = f"'{name[:64]}': {fault.field}: {fault.sentence}"
            raise DataError(told, argument=fault.field, value=str(fault.value)) from None


class AllowedContact(Model):
    """Pair with leave to touch, until a testbed time [ns]."""

    first: Text
    second: Text
    until_ns: Annotated[int, Field(ge=0)]

    @property
    def pair(self) -> frozenset[str]:
        """Both names."""
        return frozenset((self.first, self.second))


Pairs = frozenset[frozenset[str]]


@dataclass(frozen=True)
class CollisionScene:
    """Free bodies by place, and allowed contacts; every change makes new ones.

    Attributes:
        things: One a name.
        contacts: One a pair.
    """

    things: tuple[Thing, ...] = ()
    contacts: tuple[AllowedContact, ...] = ()

    def thing(self, name: str) -> Thing:
        """Return a free body.

        Raises:
            NotFoundError: It is not known.
        """
        for thing in self.things:
            if thing.name == name:
                return thing
        raise NotFoundError(kind="object", name=name, known=[thing.name for thing in self.things])

    def with_thing(self, thing: Thing) -> Self:
        """Return these with a free body at its place, in place of one of the same name.

        Raises:
            DataError: They are too many.
        """
        things = (*(each for each in self.things if each.name != thing.name), thing)
        if len(things) > MAX_BODIES:
            raise DataError(f"'{thing.name}' is one too many: {MAX_BODIES} objects are allowed", allowed=MAX_BODIES)
        return type(self)(things, self.contacts)

    def without(self, name: str) -> Self:
        """Return these without a free body and its contacts.

        Raises:
            NotFoundError: It is not known.
        """
        gone = self.thing(name)
        contacts = tuple(contact for contact in self.contacts if name not in contact.pair)
        return type(self)(tuple(thing for thing in self.things if thing is not gone), contacts)

    def with_contact(self, contact: AllowedContact) -> Self:
        """Return these with a contact, in place of one of the same pair.

        Raises:
            DataError: Both are one, or they are too many.
        """
        if contact.first == contact.second:
            raise DataError(f"a contact is of two; '{contact.first}' was named twice", value=contact.first)
        contacts = (*(each for each in self.contacts if each.pair != contact.pair), contact)
        if len(contacts) > _MOST_CONTACTS:
            raise DataError(f"{_MOST_CONTACTS} allowed contacts are there already", allowed=_MOST_CONTACTS)
        return type(self)(self.things, contacts)

    def at(self, stamp_ns: int) -> Self:
        """Return these without contacts of an ended lease, at a testbed time [ns]."""
        contacts = tuple(contact for contact in self.contacts if contact.until_ns > stamp_ns)
        return self if len(contacts) == len(self.contacts) else type(self)(self.things, contacts)

    @property
    def allowed(self) -> Pairs:
        """Pairs that may touch."""
        return frozenset(contact.pair for contact in self.contacts)


NOTHING = CollisionScene()
"""A cell without free bodies, and without contacts."""
