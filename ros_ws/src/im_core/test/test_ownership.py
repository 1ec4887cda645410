"""Files of another user, and links, are refused by name where every user of the host may make some.

Another user is played: this one takes itself for another, to whom the files that it has made are not its own.
"""

import os
import stat

import pytest

from im_core.errors import LinkError, StoreError
from im_core.files import FileError, read_bytes, write_whole
from im_core.names import run_dir
from im_core.ownership import is_own, require_own, user


@pytest.fixture
def as_another(monkeypatch):
    """A function that has this process take itself for another user."""
    mine = os.geteuid()
    return lambda: monkeypatch.setattr(os, "geteuid", lambda: mine + 1)


def test_a_file_of_another_user_is_named_with_its_owner_and_the_way_out(tmp_path, as_another):
    path = tmp_path / "im0_x"
    assert (require_own(path), is_own(path)) == (None, False)
    path.touch(0o600)
    assert (require_own(path), is_own(path)) == (path.stat().st_ino, True)
    owner = user(os.geteuid())
    as_another()
    with pytest.raises(LinkError) as refused:
        require_own(path)
    assert refused.value.message == f"{path} belongs to {owner}, not to you; remove it, or set another ROS_DOMAIN_ID"
    assert not is_own(path)


def test_a_user_without_a_name_is_a_number():
    assert user(0) == "user 0 (root)"
    assert user(2**31 - 7) == "user 2147483641"


def test_a_file_into_which_others_may_write_is_not_trusted(tmp_path):
    path = tmp_path / "im0_x"
    path.touch()
    path.chmod(0o622)
    with pytest.raises(LinkError, match=r"im0_x may be written by other users \(mode 622\); chmod go-w it, or set"):
        require_own(path)
    path.chmod(0o644)
    require_own(path)


def test_a_file_that_must_be_own_is_neither_written_nor_read_through_a_link(tmp_path):
    target, link = tmp_path / "target", tmp_path / "link"
    target.write_text("precious")
    link.symlink_to(target)
    with pytest.raises(FileError, match="link: cannot be read: Too many levels of symbolic links"):
        read_bytes(link, own=True)
    assert write_whole(link, "new", own=True) == link
    assert (target.read_text(), link.read_text(), link.is_symlink()) == ("precious", "new", False)
    assert stat.S_IMODE(link.stat().st_mode) == 0o600
    assert read_bytes(link, own=True) == b"new"


def test_a_file_that_must_be_own_is_neither_written_nor_read_where_it_is_not(tmp_path, as_another):
    path = tmp_path / "record"
    path.write_text("squatted")
    (tmp_path / "link").symlink_to(path)
    as_another()
    for name in ("record", "link"):
        with pytest.raises(LinkError, match=f"{name} belongs to user"):
            write_whole(tmp_path / name, "new", own=True)
    with pytest.raises(LinkError, match="record belongs to user"):
        read_bytes(path, own=True)
    assert path.read_text() == "squatted"
    assert sorted(os.listdir(tmp_path)) == ["link", "record"]


def test_no_file_is_written_through_a_link_that_lies_beside_it(tmp_path, monkeypatch):
    """Of the file that is written before it gets its name, whose own name another user may have foreseen."""
    made, real = {}, os.open

    def noted(path, flags, *mode):
        if flags & os.O_CREAT:
            made[path] = flags
        return real(path, flags, *mode)

    monkeypatch.setattr(os, "open", noted)
    for _ in range(2):
        write_whole(tmp_path / "record", "new")
    assert len(made) == 2
    assert all(flags & os.O_EXCL and flags & os.O_NOFOLLOW for flags in made.values())


def test_the_run_folder_is_of_this_user_alone(tmp_path, monkeypatch, as_another, capsys):
    folder = tmp_path / "new" / "run"
    monkeypatch.setenv("IM_RUN_DIR", str(folder))
    assert run_dir() == folder
    assert (stat.S_IMODE(folder.stat().st_mode), capsys.readouterr().err) == (0o700, "")
    folder.chmod(0o777)  # what lies there may be anybody's
    with pytest.raises(StoreError, match=r"run may be written by other users \(mode 777\); chmod go-w it, or set anot"):
        run_dir()
    assert stat.S_IMODE(folder.stat().st_mode) == 0o777
    folder.chmod(0o755)
    as_another()
    with pytest.raises(StoreError, match=r"run belongs to user .*, not to you; remove it, or set another IM_RUN_DIR"):
        run_dir()
    assert stat.S_IMODE(folder.stat().st_mode) == 0o755


@pytest.mark.parametrize("mode", [0o755, 0o775, 0o750, 0o701])
def test_a_run_folder_that_was_there_is_closed_to_other_users_and_that_is_said_once(
    tmp_path, monkeypatch, capsys, mode
):
    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path / "run"))
    (tmp_path / "run").mkdir()
    (tmp_path / "run").chmod(mode)
    for _ in range(2):
        assert run_dir() == tmp_path / "run"
        assert stat.S_IMODE((tmp_path / "run").stat().st_mode) == 0o700
    said = f"{tmp_path}/run was open to other users (mode {mode:o}), and is for this user alone now\n"
    assert capsys.readouterr().err == said


def test_a_folder_that_holds_more_than_the_machine_is_never_closed(tmp_path, monkeypatch):
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    for folder in (tmp_path, tmp_path / "work"):
        folder.chmod(0o755)
        monkeypatch.setenv("IM_RUN_DIR", str(folder))
        with pytest.raises(StoreError, match=r"is no folder of the machine's own; set another IM_RUN_DIR"):
            run_dir()
        assert stat.S_IMODE(folder.stat().st_mode) == 0o755
