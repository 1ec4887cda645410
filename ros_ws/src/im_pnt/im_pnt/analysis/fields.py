"""Markings packed into 64-bit words.

Each place has a field of bits, in units of the steps in which firings change it. Above the value of most fields lies a
guard bit, zero in every stored marking; a guard bit that is set after a firing says that the field has become too
narrow. A place that is proved to hold one unit at most needs no guard.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from im_pnt.analysis.units import Units

Words = npt.NDArray[np.uint64]
"""Packed markings, shape (words, markings), or numbers of that kind."""

WORD = 64
_KEY_SEED = 0x1D2C3B4A


class TooManyTokensError(Exception):
    """A place can hold more tokens than a word counts; the text says which."""


@dataclass(frozen=True, slots=True)
class Field:
    """Where the tokens of a place are: word, shift and width in bits, and whether a guard bit lies above."""

    word: int
    shift: int
    width: int
    guarded: bool


class Fields:
    """Layout of the fields of a marking.

    Args:
        units: The net in units.
        bounds: For each place the proved bound on its units, None where there is none.
        widths: For each place without a proved bound the width of its field [bits].
        attempt: Number of the hash of the keys, where markings need more than a word.

    Raises:
        TooManyTokensError: A field would be wider than a word.

    Attributes:
        units: The net in units.
        fields: The field of each place.
        words: Words of a marking.
        guards: Guard bits of each word, shape (words,).
        hash: For each place the factor of its units in the key of a marking of several words.
    """

    def __init__(self, units: Units, bounds: Sequence[int | None], widths: Sequence[int], attempt: int = 0) -> None:
        self.units = units
        self.fields = _lay_out(units, bounds, widths)
        self.words = 1 + max((field.word for field in self.fields), default=0)
        guards = [0] * self.words
        for field in self.fields:
            if field.guarded:
                guards[field.word] |= 1 << (field.shift + field.width)
        self.guards: Words = np.array(guards, np.uint64)
        self.hash = _hash(len(self.fields), attempt)

    def pack(self, vector: Sequence[int]) -> int:
        """Returns a marking, in tokens, as one integer, word 0 in its lowest bits."""
        return sum(
            self.units.of(place, count) << (f.word * WORD + f.shift)
            for place, (count, f) in enumerate(zip(vector, self.fields, strict=True))
        )

    def unpack(self, packed: int) -> tuple[int, ...]:
        """Returns the tokens of each place."""
        return tuple(
            self.units.tokens(place, (packed >> (f.word * WORD + f.shift)) & ((1 << f.width) - 1))
            for place, f in enumerate(self.fields)
        )

    def column(self, words: Words, place: int) -> Words:
        """Returns the units of one place in many markings."""
        field = self.fields[place]
        units: Words = (words[field.word] >> np.uint64(field.shift)) & np.uint64((1 << field.width) - 1)
        return units

    def holds(self, words: Words, place: int, tokens: int) -> npt.NDArray[np.bool_]:
        """Returns in which markings a place holds at least that many tokens."""
        needed = self.units.needed(place, tokens)
        if needed >> self.fields[place].width:
            return np.zeros(words.shape[1], bool)
        enough: npt.NDArray[np.bool_] = self.column(words, place) >= np.uint64(needed)
        return enough

    def repack(self, words: Words, older: "Fields") -> Words:
        """Returns markings of an older layout in this one."""
        result = np.zeros((self.words, words.shape[1]), np.uint64)
        for place, field in enumerate(self.fields):
            result[field.word] |= older.column(words, place) << np.uint64(field.shift)
        return result

    def keys(self, words: Words) -> Words:
        """Returns what the markings are looked up by: the word itself, or a hash of several words."""
        if self.words == 1:
            only: Words = words[0]
            return only
        result = np.zeros(words.shape[1], np.uint64)
        for place, factor in enumerate(self.hash):
            result += self.column(words, place) * np.uint64(factor)
        return result

    def to_words(self, packed: Sequence[int]) -> Words:
        """Returns integers as words."""
        if self.words == 1:
            return np.array(packed, np.uint64).reshape(1, -1)
        size = self.words * 8
        flat = np.frombuffer(b"".join([m.to_bytes(size, "little") for m in packed]), np.dtype("<u8"))
        return np.ascontiguousarray(flat.reshape(-1, self.words).T).astype(np.uint64, copy=False)

    def to_integers(self, words: Words) -> list[int]:
        """Returns words as integers."""
        if self.words == 1:
            integers: list[int] = words[0].tolist()
            return integers
        data, size = np.ascontiguousarray(words.T).astype("<u8", copy=False).tobytes(), self.words * 8
        return [int.from_bytes(data[at : at + size], "little") for at in range(0, len(data), size)]


def _lay_out(units: Units, bounds: Sequence[int | None], widths: Sequence[int]) -> tuple[Field, ...]:
    fields: list[Field] = []
    word = used = 0
    for place, (bound, width) in enumerate(zip(bounds, widths, strict=True)):
        guarded = bound is None or bound > 1
        bits = max(1, bound.bit_length()) if bound is not None else width
        size = bits + guarded
        if size > WORD:
            raise TooManyTokensError(f"place {units.names[place]} may hold too many tokens to list the markings")
        if used + size > WORD:
            word, used = word + 1, 0
        fields.append(Field(word, used, bits, guarded))
        used += size
    return tuple(fields)


def _hash(places: int, attempt: int) -> list[int]:
    """Returns an odd factor for each place; the sum of the products is a hash that a firing changes by a constant."""
    dice = np.random.Generator(np.random.PCG64(_KEY_SEED + attempt))
    return [2 * int(factor) + 1 for factor in dice.integers(0, 1 << 63, places, dtype=np.uint64)]
