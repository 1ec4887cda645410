import os
import subprocess
import sys

import pytest

from im_core.errors import NotFoundError
from im_core.executables import executables, packages, path_of


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


def add(workspaces, monkeypatch, package, name):
    """A package of the workspace with that program."""
    program = workspaces / "ws" / package / "lib" / package / name
    program.parent.mkdir(parents=True, exist_ok=True)
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{workspaces}/ws/{package}:{os.environ['AMENT_PREFIX_PATH']}")
    return program


INTERRUPTED_AS_IT_LOADS = """
import os, signal, sys
print(*sys.argv[1:], flush=True)
os.kill(os.getpid(), signal.SIGINT)
print("goes on")
"""


@pytest.mark.parametrize("first", ["#!{python}", "#!/usr/bin/env python3"], ids=["in this process", "in its place"])
def test_a_script_gets_its_arguments_and_its_end_is_ours(workspaces, monkeypatch, first):
    program = add(workspaces, monkeypatch, "mine", "tool")
    program.write_text(f"{first.format(python=sys.executable)}\nimport sys\nprint(*sys.argv)\nsys.exit(7)\n")
    run = [sys.executable, "-m", "im_core.executables", "mine", "tool", "--option", "7"]
    done = subprocess.run(run, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (7, f"{program} --option 7\n", "")


def test_ctrl_c_while_an_executable_is_loaded_ends_it_without_a_traceback(workspaces, monkeypatch):
    program = add(workspaces, monkeypatch, "mine", "tool")
    program.write_text(f"#!{sys.executable}\n{INTERRUPTED_AS_IT_LOADS}")
    run = [sys.executable, "-m", "im_core.executables", "mine", "tool", "begins"]
    done = subprocess.run(run, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "begins\n", "")


def test_ctrl_c_before_anything_is_loaded_is_not_lost():
    """``scripts/im`` has the kernel keep it until there is somebody to take it."""
    command = 'kill -INT $$; exec "$0" -m im_core.executables im_core none'
    run = ["env", "--block-signal=INT", "bash", "-c", command, sys.executable]
    done = subprocess.run(run, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")
