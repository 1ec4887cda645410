"""The object store without ROS."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from im_core.errors import DataError, NotFoundError, StateError
from im_dom.store import ObjectStore

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


@pytest.mark.parametrize("name", ["", "1a", "a b", "x" * 200, "a;drop table objects"])
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


def test_a_file_that_is_no_database_is_named(tmp_path: Path) -> None:
    (tmp_path / "dom.sqlite").write_bytes(b"no database at all, but long enough to be read as one" * 40)
    with pytest.raises(DataError, match=r"dom\.sqlite cannot be opened"):
        ObjectStore(tmp_path / "dom.sqlite")
