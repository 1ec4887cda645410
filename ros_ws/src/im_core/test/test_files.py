"""Files that are written whole or not at all."""

import os
import stat
import threading
from pathlib import Path

import pytest

from im_core.errors import StoreError
from im_core.files import is_same, make_folder, make_mark, synchronise_mark, write_whole


def test_text_and_bytes_replace_what_was_there(tmp_path):
    path = tmp_path / "a.txt"
    assert write_whole(path, "grün\n") == path
    assert path.read_bytes() == "grün\n".encode()
    write_whole(path, b"\x00\xff")
    assert path.read_bytes() == b"\x00\xff"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_the_umask_decides_who_may_read(tmp_path):
    before = os.umask(0o027)
    try:
        assert stat.S_IMODE(write_whole(tmp_path / "a", "").stat().st_mode) == 0o640
    finally:
        os.umask(before)


def test_a_file_is_the_same_by_another_name(tmp_path):
    one, other, link = (tmp_path / name for name in ("one", "other", "link"))
    one.write_text("1")
    other.write_text("1")
    link.symlink_to(one)
    assert is_same(one, str(link))
    assert not is_same(one, other)
    assert not is_same(one, tmp_path / "none")
    assert not is_same(tmp_path / "none", tmp_path / "none")


def test_a_link_stays_a_link(tmp_path):
    (tmp_path / "there").write_text("old")
    (tmp_path / "link").symlink_to("there")
    write_whole(tmp_path / "link", "new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "there").read_text() == "new"


def test_what_cannot_be_written_leaves_nothing(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "full").touch()
    with pytest.raises(OSError, match="folder"):
        write_whole(tmp_path / "folder", "text")
    with pytest.raises(StoreError, match=r"missing/a cannot be written: No such file or directory"):
        write_whole(tmp_path / "missing" / "a", "text")
    with pytest.raises(UnicodeEncodeError):
        write_whole(tmp_path / "b", "\ud800")
    assert os.listdir(tmp_path) == ["folder"]


def test_a_reader_sees_one_whole_version(tmp_path):
    path = write_whole(tmp_path / "a", "0" * 50_000)
    done = threading.Event()
    seen = set()

    def read():
        while not done.is_set():
            seen.add(path.read_text())

    reader = threading.Thread(target=read)
    reader.start()
    writers = [
        threading.Thread(target=lambda digit=digit: [write_whole(path, digit * 50_000) for _ in range(20)])
        for digit in "123"
    ]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    done.set()
    reader.join()
    assert seen <= {digit * 50_000 for digit in "0123"}
    assert os.listdir(tmp_path) == ["a"]


def test_a_new_folder_is_there_after_a_loss_of_power(tmp_path, monkeypatch):
    synchronised = []

    def note(descriptor):
        synchronised.append(Path(f"/proc/self/fd/{descriptor}").readlink())

    monkeypatch.setattr(os, "fsync", note)
    assert make_folder(tmp_path / "a" / "b") == tmp_path / "a" / "b"
    assert sorted(synchronised) == [tmp_path, tmp_path / "a"]
    make_folder(tmp_path / "a" / "b")
    assert len(synchronised) == 2


def test_what_is_no_file_stays_what_it_is_and_a_new_version_has_the_rights_of_the_one_before(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(StoreError, match=r"pipe cannot be written: it is no regular file"):
        write_whole(tmp_path / "pipe", "text")
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)
    private = write_whole(tmp_path / "private", "old")
    private.chmod(0o600)
    assert stat.S_IMODE(write_whole(private, "new").stat().st_mode) == 0o600


def test_the_presence_of_a_mark_counts_and_the_first_one_stays(tmp_path):
    mark = tmp_path / "mark"
    make_mark(mark, "first")
    make_mark(mark, "second")
    synchronise_mark(mark)
    assert mark.read_text() == "first"
    with pytest.raises(StoreError, match="cannot be made"):
        make_mark(tmp_path / "missing" / "mark", "")
    with pytest.raises(StoreError, match="cannot be synchronised"):
        synchronise_mark(tmp_path / "missing" / "mark")
