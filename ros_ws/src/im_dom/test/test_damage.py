"""Bits of the object store's files are flipped, and its files cut, one at a time: nothing wrong is given as data."""

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from random import Random

import pytest

from im_core.errors import NotFoundError, StateError
from im_dom.object_record import DamagedObjectError, ObjectRecord
from im_dom.store import ObjectStore

KIND = "std_msgs/msg/String"
FILES = ("dom.sqlite", "dom.sqlite-wal", "dom.sqlite-list", "dom.sqlite-shm")
#: What a store says of an object: record and data; None: it is not there, or not valid.
Known = dict[str, tuple[ObjectRecord, bytes] | None]


def known(store: ObjectStore, names: set[str]) -> Known:
    """What a store gives; an object that is damaged is left out."""
    found: Known = {}
    for name in names:
        try:
            found[name] = store.get(name)
        except (NotFoundError, StateError):
            found[name] = None
        except DamagedObjectError:
            continue
    return found


def change(store: ObjectStore, first: int) -> None:
    """Changes of each kind; of an odd object the name is one that a net gives."""
    for number in range(first, first + 8):
        store.put(f"object/{number}", KIND, bytes([number]) * 40 * number, "net.place", "test", number)
    store.together([lambda: store.put("often", KIND, b"%d" % first, "", "test", 1)] * 3)
    store.put("large", KIND, bytes(range(256)) * 60, "", "test", first)
    store.append("often", KIND, lambda data: data + b"more", "test", 2, request=f"request {first}")
    store.invalidate(f"object/{first}", "test", 3)
    store.put(f"forgotten/{first}", KIND, b"forgotten", "", "test", 4)
    store.forget("forgotten/")
    store.invalidate(f"object/{first + 7}", "test", 5)


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Known]:
    """The files of a store whose process was killed, and what the store had said; half of it is still in the log."""
    folder = tmp_path_factory.mktemp("killed")
    first = ObjectStore(folder / "dom.sqlite")
    change(first, 0)
    first.close()
    second = ObjectStore(folder / "dom.sqlite")
    change(second, 8)
    copy = tmp_path_factory.mktemp("copy")
    for name in FILES:
        shutil.copyfile(folder / name, copy / name)
    names = {f"object/{number}" for number in range(16)} | {"often", "large", "forgotten/0", "forgotten/8"}
    expected = known(second, names)
    second.close()
    return copy, expected


def judged(killed: tuple[Path, Known], folder: Path, damage: Callable[[Path], None]) -> str:
    """What a store says of damage to its files; what it gives is what was stored, and stays so."""
    copy, expected = killed
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(copy, folder)
    damage(folder)
    store = ObjectStore(folder / "dom.sqlite")
    found = known(store, {*expected})
    assert found == {name: expected[name] for name in found}
    lost = expected.keys() - found.keys()
    for name in lost:
        with pytest.raises(DamagedObjectError, match=f"'{name}' cannot be read: in the object store {store._path} "):
            store.get(name)
        assert any(name in sentence for sentence in store.damages())
        assert name in store.aside
    for name in sorted(lost)[:1]:
        store.put(name, KIND, b"anew", "", "test", 1)
        found[name] = store.get(name)
    store.close()
    again = ObjectStore(folder / "dom.sqlite")
    assert again.aside == ""
    assert known(again, {*expected}) == found
    again.close()
    return store.aside


def flipped(file: str, bit: int) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        content = bytearray((folder / file).read_bytes())
        content[bit // 8] ^= 1 << bit % 8
        (folder / file).write_bytes(content)

    return damage


def places(size: int, draw: Random, count: int) -> Iterator[int]:
    """Bits at random, half of them where a page or a frame begins and tells what is in it."""
    for number in range(count):
        at = draw.randrange(size)
        if number % 2 and size > 4096:
            at = at - at % 4096 + draw.randrange(120)
        yield 8 * min(at, size - 1) + draw.randrange(8)


@pytest.mark.parametrize("file", FILES)
def test_a_flipped_bit_anywhere_is_said_and_nothing_wrong_is_given(killed, tmp_path, file):
    size = (killed[0] / file).stat().st_size
    for bit in places(size, Random(1), 24):
        said = judged(killed, tmp_path / "store", flipped(file, bit))
        assert said or file.endswith("-shm"), f"bit {bit} of {file}"
        assert not said or "dom-damaged-" in said


def test_a_store_that_nobody_closed_is_whole(tmp_path):
    """A process that ends by an error leaves its connections to Python, and SQLite moves the log with the last."""
    store = ObjectStore(tmp_path / "dom.sqlite")
    store.put("a", "t/msg/T", b"one", "", "", 0)
    del store
    again = ObjectStore(tmp_path / "dom.sqlite")
    assert again.aside == ""
    assert again.get("a")[1] == b"one"
    again.close()
