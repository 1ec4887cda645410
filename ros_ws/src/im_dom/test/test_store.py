"""The object store without ROS."""

import os
import sqlite3
from contextlib import closing
from functools import partial
from pathlib import Path
from shutil import copytree, ignore_patterns, rmtree
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_core.errors import DataError, NotFoundError, StateError
from im_core.files import MEBIBYTE
from im_core.store_mark import StoreMark
from im_dom import store as objects
from im_dom.cache import ObjectCache
from im_dom.object_record import ObjectRecord
from im_dom.store import KEPT_VERSIONS, LARGEST, ObjectStore

KIND = "std_msgs/msg/String"


def put(store: ObjectStore, name: str = "path", data: bytes = b"abc", kind: str = KIND) -> None:
    store.put(name, kind, data, "motion_coordinator.path_valid", "tester", 7)


@given(st.lists(st.binary(max_size=200), min_size=1, max_size=6))
def test_last_put_is_what_is_read(blobs: list[bytes]) -> None:
    store = ObjectStore()
    for blob in blobs:
        put(store, data=blob)
    record, data = store.get("path", KIND)
    assert data == blobs[-1]
    assert record.version == len(blobs)
    assert record.size == len(blobs[-1])


def test_invalid_object_is_not_given_out_until_put_again() -> None:
    store = ObjectStore()
    put(store)
    store.invalidate("path", "someone", 9)
    with pytest.raises(StateError, match=r"'path' .* is not valid; someone"):
        store.get("path")
    assert [record.valid for record in store.records()] == [False]
    put(store)
    assert store.get("path")[0].version == 2


def test_wrong_type_and_wrong_name_are_named() -> None:
    store = ObjectStore()
    put(store)
    with pytest.raises(DataError, match="is a std_msgs/msg/String, not a std_msgs/msg/Bool"):
        store.get("path", "std_msgs/msg/Bool")
    with pytest.raises(NotFoundError, match="did you mean 'path'"):
        store.get("paht")


@pytest.mark.parametrize("name", ["", "1a", "a b", "x" * 200, "a;drop table objects", "a/"])
def test_malformed_names_are_refused(name: str) -> None:
    with pytest.raises(DataError, match="name of a data object"):
        put(ObjectStore(), name=name)


def test_objects_outlive_the_process(tmp_path: Path) -> None:
    first = ObjectStore(tmp_path / "dom.sqlite")
    put(first, data=b"kept")
    first.close()
    assert ObjectStore(tmp_path / "dom.sqlite").get("path")[1] == b"kept"


def test_prefix_lists_only_what_begins_with_it() -> None:
    store = ObjectStore()
    for name in ("calib/a", "calib/b", "path"):
        put(store, name=name)
    assert [record.name for record in store.records("calib/")] == ["calib/a", "calib/b"]


def test_what_is_below_a_name_is_forgotten_and_nothing_else() -> None:
    store = ObjectStore()
    for name in ("boss/1/a", "boss/1/b", "boss/10/a", "boss/1", "other/boss/1/a"):
        put(store, name=name)
    store.invalidate("boss/1/b", "someone", 9)
    gone = store.forget("boss/1/")
    assert [(record.name, record.valid) for record in gone] == [("boss/1/a", False)]
    assert [record.name for record in store.records()] == ["boss/1", "boss/10/a", "other/boss/1/a"]
    assert store.forget("boss/1/") == []


GARBAGE = b"no database at all, but long enough to be read as one" * 400


def test_what_was_put_for_a_place_that_a_net_has_no_more_is_not_valid() -> None:
    store = ObjectStore(":memory:")
    for name, place in (("gone", "pick.held"), ("stays", "pick.seen"), ("of_others", "picker.held"), ("of_none", "")):
        store.put(name, KIND, b"abc", place, "test", 0)
    store.put("invalid", KIND, b"abc", "pick.held", "test", 0)
    store.invalidate("invalid", "someone", 1)
    (changed,) = store.abandon("pick", {"seen", "other"}, "dom", 9)
    assert (changed.name, changed.valid, changed.source, changed.stamp_ns) == ("gone", False, "dom", 9)
    assert [record.name for record in store.records() if record.valid] == ["of_none", "of_others", "stays"]
    assert store.record("invalid").source == "someone"
    assert [record.name for record in store.abandon("pick", (), "dom", 9)] == ["stays"], "the net has gone"


def torn(file: Path) -> bytes:
    """A data base of which pages in the middle are lost."""
    store = ObjectStore(file)
    for number in range(40):
        put(store, name=f"object/{number}", data=bytes([number]) * 3000)
    store.close()
    content = bytearray(file.read_bytes())
    content[4096:40960] = bytes(36864)
    return bytes(content)


@pytest.mark.parametrize("damage", [lambda _: GARBAGE, torn, lambda file: torn(file)[:50_000]])
def test_a_damaged_file_is_kept_as_it_is_and_named_and_a_new_one_begun(tmp_path: Path, damage) -> None:
    file = tmp_path / "dom.sqlite"
    content = damage(file)
    file.write_bytes(content)
    store = ObjectStore(file)
    (aside,) = tmp_path.glob("dom-damaged-*")
    assert (aside / "dom.sqlite").read_bytes() == content
    assert store.aside.startswith(f"the object store {file} is damaged (")
    assert f"it is kept in {aside}" in store.aside
    assert store.records() == []
    put(store, data=b"new")
    store.close()
    again = ObjectStore(file)
    assert again.get("path")[1] == b"new"
    assert again.aside == ""


def test_a_file_of_another_version_is_set_aside_too(tmp_path: Path) -> None:
    with closing(sqlite3.connect(tmp_path / "dom.sqlite")) as db:
        db.execute("CREATE TABLE objects (name TEXT PRIMARY KEY)")
    store = ObjectStore(tmp_path / "dom.sqlite")
    assert "is of another version of this software (0, not 6)" in store.aside


def test_a_file_in_a_folder_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"dom\.sqlite cannot be opened"):
        ObjectStore(tmp_path / "nowhere" / "dom.sqlite")


def test_a_second_keeper_of_a_file_is_refused_by_the_process_of_the_first(tmp_path: Path) -> None:
    with closing(ObjectStore(tmp_path / "dom.sqlite")) as store:
        put(store, "a", b"1")
        with pytest.raises(StateError, match=f"in use by process {os.getpid()}"):
            ObjectStore(tmp_path / "dom.sqlite")
        put(store, "a", b"2")
    with closing(ObjectStore(tmp_path / "dom.sqlite")) as store:
        assert store.get("a")[1] == b"2"


@given(st.lists(st.integers(0, 60), min_size=1, max_size=30))
def test_older_versions_are_kept_while_they_are_few_and_small(sizes: list[int]) -> None:
    """Against a list that is cut from its front."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(objects, "KEPT_BYTES", 100)
        store, model = ObjectStore(), []
        for version, size in enumerate(sizes, start=1):
            put(store, data=bytes([version]) * size)
            model.append((version, bytes([version]) * size))
            while len(model) > KEPT_VERSIONS or sum(len(data) for _, data in model[:-1]) > 100:
                del model[0]
        for version, data in model:
            assert store.get("path", version=version)[1] == data
        with pytest.raises(NotFoundError, match="version of data object 'path'"):
            store.get("path", version=model[0][0] - 1 or 99)
        assert store.forget("path") != []
        with pytest.raises(NotFoundError):
            store.get("path", version=model[0][0])


def test_an_older_version_is_given_out_though_the_object_is_not_valid() -> None:
    store = ObjectStore()
    put(store, data=b"one")
    put(store, data=b"two")
    store.invalidate("path", "someone", 9)
    assert store.get("path", version=1)[1] == b"one"


def test_where_an_object_comes_from_is_kept() -> None:
    store = ObjectStore()
    name = "dispatcher/20260131-142501-7/goal"
    store.put(name, KIND, b"", "net.place", "planner", 7, kind_hash="RIHS01_aa")
    store.put("calibration", KIND, b"", "", "planner", 8, command="dispatcher/20260131-142501-7")
    found = store.record(name)
    assert (found.source, found.command, found.place, found.stamp_ns, found.hash) == (
        "planner",
        "dispatcher/20260131-142501-7",
        "net.place",
        7,
        "RIHS01_aa",
    )
    assert store.record("calibration").command == found.command


def test_a_large_object_is_kept_and_a_larger_one_refused_by_its_length() -> None:
    store = ObjectStore()
    put(store, data=bytes(LARGEST))
    with pytest.raises(DataError, match=f"'path' has {LARGEST + 1} bytes; at most {LARGEST} \\(64 MiB\\) are kept"):
        put(store, data=bytes(LARGEST + 1))
    assert store.get("path")[0].size == LARGEST


def test_what_is_done_together_is_answered_one_by_one() -> None:
    store = ObjectStore()
    put(store, "kept")

    def breaks() -> None:
        put(store, "kept", b"half")
        raise ZeroDivisionError

    first, wrong, broken, read, last = store.together(
        [
            lambda: store.put("a", KIND, b"1", "", "t", 1),
            lambda: store.put("1", KIND, b"2", "", "t", 1),
            breaks,
            lambda: store.get("kept"),
            lambda: store.get("a"),
        ]
    )
    assert (first.name, first.version) == ("a", 1)
    assert isinstance(wrong, DataError)
    assert isinstance(broken, ZeroDivisionError)
    assert read[1] == b"abc"
    assert last[1] == b"1"


def append(store: ObjectStore, more: bytes, request: str = "", name: str = "path") -> ObjectRecord:
    return store.append(name, KIND, lambda data: data + more, "appender", 8, request=request)


@given(st.lists(st.tuples(st.binary(max_size=9), st.integers(0, 5)), max_size=9))
def test_each_request_to_append_has_its_effect_once(asked: list[tuple[bytes, int]]) -> None:
    """However often it is made, and whatever comes between; against a list."""
    store = ObjectStore()
    put(store, data=b"begun ")
    model, made = [b"begun "], dict[int, int]()
    for more, number in asked:
        version = append(store, more, f"request {number}").version
        if number not in made:
            model.append(model[-1] + more)
            made[number] = len(model)
        assert version == made[number]
    record, data = store.get("path")
    assert (data, record.version) == (model[-1], len(model))


def test_an_object_that_grows_stays_what_it_was_put_for() -> None:
    store = ObjectStore()
    store.put("path", KIND, b"1", "net.place", "planner", 7, kind_hash="RIHS01_aa", command="node/20260131-142501-7")
    found = append(store, b"2")
    assert (found.place, found.command, found.hash) == ("net.place", "node/20260131-142501-7", "RIHS01_aa")
    assert (found.source, found.stamp_ns, found.version) == ("appender", 8, 2)
    assert store.get("path", version=1)[1] == b"1"


def test_what_cannot_grow_is_as_it_was() -> None:
    store = ObjectStore()
    with pytest.raises(NotFoundError, match="data object 'path'"):
        append(store, b"2")
    put(store, data=b"1")
    with pytest.raises(DataError, match="at most 67108864"):
        append(store, bytes(LARGEST))
    with pytest.raises(DataError, match="is a std_msgs/msg/String, not a std_msgs/msg/Bool"):
        store.append("path", "std_msgs/msg/Bool", bytes, "appender", 8)
    assert (store.get("path")[1], store.record("path").version) == (b"1", 1)
    store.invalidate("path", "someone", 9)
    with pytest.raises(StateError, match="is not valid; someone"):
        append(store, b"2")


def test_requests_to_append_are_remembered_up_to_a_number(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(objects, "KEPT_REQUESTS", 2)
    store = ObjectStore()
    put(store, data=b"")
    for number in range(3):
        append(store, b"x", str(number))
    append(store, b"x", "1")
    assert store.get("path")[1] == b"xxx"
    append(store, b"x", "0")
    assert store.get("path")[1] == b"xxxx"


def test_what_is_done_together_is_on_the_disk_as_one_when_it_is_answered(tmp_path: Path) -> None:
    store = ObjectStore(tmp_path / "dom.sqlite")
    with closing(sqlite3.connect(tmp_path / "dom.sqlite")) as other:
        seen = []

        def look() -> None:
            seen.append(other.execute("SELECT count(*) FROM versions").fetchone()[0])

        store.together([lambda: put(store, "a"), look, lambda: put(store, "b"), look])
        look()
    assert seen == [0, 0, 2]
    assert store._db.execute("PRAGMA synchronous").fetchone() == (2,)  # FULL: each commit waits for the disk
    assert store._db.execute("PRAGMA journal_mode").fetchone() == ("wal",)


NAMES = st.sampled_from(["a", "b", "below/a", "below/b"])


@settings(max_examples=30)
@given(
    st.lists(
        st.lists(
            st.tuples(st.sampled_from(["put", "append", "invalidate", "forget", "get", "break"]), NAMES), max_size=5
        ),
        max_size=8,
    )
)
def test_what_is_in_memory_is_what_is_on_the_disk(groups: list[list[tuple[str, str]]]) -> None:
    """Whatever is done together, and whether it succeeds: the file that is opened anew says the same."""

    def broken() -> None:
        put(store, "a", b"half")
        store.forget("below/")
        raise ZeroDivisionError

    with TemporaryDirectory() as folder:
        store, number = ObjectStore(Path(folder) / "dom.sqlite"), 0
        for group in groups:
            works = []
            for what, name in group:
                number += 1
                works.append(
                    {
                        "put": partial(put, store, name, b"put %d" % number),
                        "append": partial(append, store, b"+%d" % number, str(number % 3), name),
                        "invalidate": partial(store.invalidate, name, "someone", number),
                        "forget": partial(store.forget, "below/"),
                        "get": partial(store.get, name),
                        "break": broken,
                    }[what]
                )
            store.together(works)
            copy = Path(folder) / "copy"
            copytree(folder, copy, ignore=ignore_patterns("copy"))
            anew = ObjectStore(copy / "dom.sqlite")
            assert anew.records() == store.records()
            for record in anew.records():
                if not record.valid:
                    assert store.cached(record.name) is None
                    continue
                there = anew.get(record.name)
                assert store.cached(record.name) in (None, there)
                assert store.get(record.name) == there
                assert store.cached(record.name) == there
            for name in {"a", "b", "below/a", "below/b"} - {record.name for record in anew.records()}:
                assert store.cached(name) is None
            anew.close()
            rmtree(copy)
        store.close()


@pytest.mark.parametrize("size", [5, MEBIBYTE // 100])
@pytest.mark.parametrize("count", [1, 2, 63, 64, 65, 200])
def test_of_any_number_put_together_the_newest_versions_are_in_the_file(tmp_path: Path, count: int, size: int) -> None:
    store, puts = ObjectStore(tmp_path / "dom.sqlite"), list(range(3 * count))
    for first in (0, count, 2 * count):
        works = [partial(put, store, f"o{number % 3}", bytes([number % 256]) * size) for number in puts[first:][:count]]
        store.together(works)
    known = {record.name: record for record in store.records()}
    store.close()
    again = ObjectStore(tmp_path / "dom.sqlite")
    assert {record.name: record for record in again.records()} == known
    for name, record in known.items():
        numbers = [number for number in puts if f"o{number % 3}" == name]
        for version in range(max(1, record.version - KEPT_VERSIONS + 1), record.version + 1):
            assert again.get(name, version=version)[1] == bytes([numbers[version - 1] % 256]) * size
        if record.version > KEPT_VERSIONS:
            with pytest.raises(NotFoundError):
                again.get(name, version=record.version - KEPT_VERSIONS)


def test_of_the_newest_versions_those_used_last_stay_in_memory() -> None:
    cache, kept = ObjectCache(64 * 1024), b"x" * 1000
    sizes = {"a": kept, "b": kept, "large": bytes(5000), **{str(number): kept for number in range(40)}}
    for name, data in sizes.items():
        record = ObjectRecord(name, 1, KIND, "", True, "", "tester", "", 7, len(data))
        cache.update({name: (record, data)})
        cache.get("a")
    assert cache.get("large") is None
    assert cache.get("b") is None
    there = [name for name in sizes if cache.get(name)]
    assert there == ["a", *map(str, range(9, 40))]


def test_the_mark_of_a_store_grows_with_each_transaction_and_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "dom.sqlite"
    store = ObjectStore(path)
    begun = store.mark
    assert (begun.number, StoreMark.of(str(begun))) == (0, begun)
    store.put("a", KIND, b"1", "", "test", 1)
    store.together([lambda: store.put("b", KIND, b"1", "", "test", 1)] * 3)
    store.get("a")
    assert store.mark == (begun.store, 2)
    store.close()
    store = ObjectStore(path)
    assert store.mark == (begun.store, 2)
    store.close()
    content = bytearray(path.read_bytes())
    content[72] ^= 1  # what is whole goes to a new file, which is the same store
    path.write_bytes(content)
    store = ObjectStore(path)
    assert (bool(store.aside), store.mark) == (True, (begun.store, 2))
    store.close()
    for part in tmp_path.glob("dom.sqlite*"):
        part.unlink()
    assert ObjectStore(path).mark.store != begun.store
