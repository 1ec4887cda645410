"""Paths that messages name lead below configured folders alone, whatever they are made of."""

import os
from pathlib import Path

import pytest

from im_core.errors import DataError
from im_core.message_paths import hand_over, message_folders, resolve_below


@pytest.fixture
def folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """The folders of a machine, all below ``tmp_path``; beside them is a secret."""
    monkeypatch.setenv("IM_RESULTS_DIR", str(tmp_path / "results"))
    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path / "run"))
    monkeypatch.setenv("IM_FOLDERS", f"{tmp_path / 'mine'}{os.pathsep}")
    (tmp_path / "mine/deep").mkdir(parents=True)
    (tmp_path / "mine-not").mkdir()
    (tmp_path / "secret").write_text("secret")
    (tmp_path / "mine/link").symlink_to(tmp_path / "secret")
    (tmp_path / "mine/away").symlink_to(tmp_path)
    (tmp_path / "results").mkdir()
    (tmp_path / "results/near").symlink_to(tmp_path / "mine/deep")
    return message_folders()


def test_the_folders_are_results_what_was_handed_over_and_those_that_are_configured(
    folders: list[Path], tmp_path: Path
) -> None:
    assert folders == [tmp_path / "results", tmp_path / "run/given", tmp_path / "mine"]


@pytest.mark.parametrize(
    ("path", "place"),
    [
        ("a.yaml", "results/a.yaml"),
        ("near/a.yaml", "mine/deep/a.yaml"),
        ("{}/mine/deep/../a.yaml", "mine/a.yaml"),
        ("{}/mine/not_there/a.yaml", "mine/not_there/a.yaml"),
        ("{}/results", "results"),
    ],
)
def test_what_is_below_is_resolved(folders: list[Path], tmp_path: Path, path: str, place: str) -> None:
    assert resolve_below(path.format(tmp_path), folders, "file") == tmp_path / place


@pytest.mark.parametrize(
    "path",
    ["/etc/passwd", "{}/secret", "{}/mine/link", "{}/mine/../secret", "{}/mine/away/secret", "../secret", "{}/mine-not",
     "{}", "/", "..", "near/../../../secret", "{}/nowhere", "a\0b", "x" * 5000 + "/../../../secret"],
)  # fmt: skip
def test_what_leads_out_is_refused_whether_it_is_there_or_not(folders: list[Path], tmp_path: Path, path: str) -> None:
    with pytest.raises(DataError, match=r"^poses_file: '.*' is (outside of .*results, .*IM_FOLDERS|no path)"):
        resolve_below(path.format(tmp_path), folders, "poses_file")


def test_what_a_client_hands_over_is_one_copy_that_may_be_named(folders: list[Path], tmp_path: Path) -> None:
    (tmp_path / "poses.yaml").write_text("group: left")
    copies = {hand_over(tmp_path / "poses.yaml") for _ in range(2)}
    assert len(copies) == 1
    (copy,) = copies
    assert (resolve_below(str(copy), folders, "file"), copy.name) == (copy, "poses.yaml")
    assert copy.read_text() == "group: left"
