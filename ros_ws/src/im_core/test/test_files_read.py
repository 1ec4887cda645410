"""Files from elsewhere: whatever a path leads to, it is read within limits or refused in one sentence."""

import os
import shutil
import socket
import tracemalloc

import pytest

from im_bag.reading import open_bag
from im_core.config import Model, load_model
from im_core.errors import ConfigError
from im_core.files import FileError, read_bytes, read_text
from im_core.text.jsontext import load_json


def folder(path):
    path.mkdir()
    return path


def pipe(path):
    os.mkfifo(path)
    return path


def unix_socket(path):
    server = socket.socket(socket.AF_UNIX)
    try:
        server.bind(str(path))
    finally:
        server.close()
    return path


def circle(path):
    path.symlink_to(path)
    return path


ODD = {
    "a folder": (folder, "not a regular file"),
    "a pipe": (pipe, "not a regular file"),
    "a socket": (unix_socket, "cannot be read"),
    "a circle of links": (circle, "Too many levels of symbolic links"),
    "nothing": (lambda path: path, "No such file or directory"),
    "an endless device": (lambda path: "/dev/zero", "not a regular file"),
    "a name with a zero": (lambda path: f"{path}\0", "embedded null byte"),
    "a name with half a character": (lambda path: f"{path}\ud800", "cannot be read"),
    "a name that is too long": (lambda path: f"{path}{'x' * 5000}", "File name too long"),
    "no name": (lambda path: "", "cannot be read"),
}


@pytest.mark.parametrize(("make", "sentence"), ODD.values(), ids=ODD)
def test_odd_paths_are_refused_at_once(tmp_path, make, sentence):
    path = make(tmp_path / "odd")
    for read in (read_bytes, read_text, load_json):
        with pytest.raises(FileError, match=sentence) as refused:
            read(path)
        refused.value.message.encode()  # a message of ROS can hold it
        assert "\0" not in refused.value.message
    with pytest.raises(ConfigError, match=sentence if path else "not a regular file"):
        load_model(path, Model)


def test_no_more_is_read_than_may_be_there(tmp_path):
    path = tmp_path / "large"
    with path.open("wb") as file:
        file.truncate(10 * 2**30)  # a hole: it takes no disk
    tracemalloc.start()
    try:
        with pytest.raises(FileError, match="large: is larger than 1 MiB, which is the limit"):
            read_bytes(path, 2**20)
        assert tracemalloc.get_traced_memory()[1] < 4 * 2**20
    finally:
        tracemalloc.stop()
    path.write_bytes(b"x" * 2**20)
    assert len(read_bytes(path, 2**20)) == 2**20


def test_text_is_utf_8_with_or_without_its_mark(tmp_path):
    path = tmp_path / "a"
    path.write_bytes("\ufeffgr\u00fcn".encode())
    assert read_text(path) == "gr\u00fcn"
    path.write_bytes(b"ab\nc\xff")
    with pytest.raises(FileError, match="a:2:2: is not UTF-8 text"):
        read_text(path)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("[" * 100_000, "nest deeper than 40"),
        ("- " * 1000, "nest deeper than 40"),
        ("a: &a [1, 2]\n" + "".join(f"{c}: &{c} [*{chr(ord(c) - 1)}, *{chr(ord(c) - 1)}]\n" for c in
                                    "bcdefghijklmnopqrstuvwxyz"), "more than 500000 values"),
        ("a: &a [*a]", "contains itself"),
        ("a: !!python/object/apply:os.system [ls]", "tag '.*' is not allowed"),
        ('a: "\\ud800"', "half a character|not YAML"),
        ("a: \x00", "not YAML"),
    ],
)  # fmt: skip
def test_yaml_that_no_file_needs_is_refused(tmp_path, text, sentence):
    path = tmp_path / "a.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=sentence) as refused:
        load_model(path, Model)
    assert refused.value.message.startswith(f"{path}:")


@pytest.fixture
def bag(tmp_path):
    """A bag without messages."""
    from rosbags.rosbag2 import StoragePlugin, Writer

    with Writer(tmp_path / "bag", version=Writer.VERSION_LATEST, storage_plugin=StoragePlugin.MCAP):
        pass
    return tmp_path / "bag"


def damage(file, content):
    def change(bag):
        path = bag / file
        path.unlink()
        if isinstance(content, bytes):
            path.write_bytes(content)
        else:
            content(path)

    return change


DAMAGES = {
    "metadata nest": (damage("metadata.yaml", b"[" * 10_000), "metadata.yaml:1: values nest deeper"),
    "metadata are a pipe": (damage("metadata.yaml", pipe), "not a regular file"),
    "metadata are data": (damage("metadata.yaml", b"3"), "cannot be read"),
    "metadata are large": (damage("metadata.yaml", b" " * (2**24 + 1)), "larger than 16 MiB"),
    "data are a pipe": (damage("bag.mcap", pipe), "not a regular file"),
    "data are cut": (damage("bag.mcap", b"\x89MCAP"), "lacks its end, as a copy"),
    "data are empty": (damage("bag.mcap", b""), "lacks its end, as a copy"),
    "gone": (lambda bag: shutil.rmtree(bag), "bag: cannot be read"),
}


@pytest.mark.parametrize(("change", "sentence"), DAMAGES.values(), ids=DAMAGES)
def test_a_damaged_bag_is_refused_in_a_sentence(bag, change, sentence):
    open_bag(bag).close()
    change(bag)
    with pytest.raises(FileError, match=sentence):
        open_bag(bag)
