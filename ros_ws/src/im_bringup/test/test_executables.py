import pytest

from im_bringup.executables import executables, packages, path_of
from im_core.errors import NotFoundError


@pytest.fixture
def workspaces(tmp_path, monkeypatch):
    """A workspace with package ``near``, and below it an installation with ``near`` and ``far``."""
    for prefix, package, name in (("ws/near", "near", "go"), ("ros", "near", "old"), ("ros", "far", "run")):
        program = tmp_path / prefix / "lib" / package / name
        program.parent.mkdir(parents=True)
        program.write_text("#!/bin/sh\n")
        program.chmod(0o755)
        (program.parent / "data.txt").write_text("not a program")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path}/ws/near:{tmp_path}/ros")
    monkeypatch.setenv("COLCON_PREFIX_PATH", f"{tmp_path}/ws")
    return tmp_path


def test_the_nearest_workspace_comes_first(workspaces):
    assert executables("near") == ["go"]
    assert path_of("near", "go") == workspaces / "ws/near/lib/near/go"
    assert path_of("far", "run") == workspaces / "ros/lib/far/run"


def test_only_packages_of_workspaces_are_listed(workspaces):
    assert packages() == ["near"]


def test_unknown_names_are_answered_with_the_known_ones(workspaces):
    with pytest.raises(NotFoundError, match=r"no package with executables 'nears'; did you mean 'near'"):
        executables("nears")
    with pytest.raises(NotFoundError, match=r"no executable of near 'og' \(known: go\)|did you mean 'go'"):
        path_of("near", "og")
