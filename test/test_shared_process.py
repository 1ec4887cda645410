"""Executables that share a process are run up to where they would spin their nodes, and no further."""

import sys

import pytest

from im_bringup.ros.shared_process import programs_of
from im_core.errors import ConfigError, NotFoundError

ALONE = """#!{python}
import sys
from im_core.ros import run
from im_core.ros.node import ManagedNode
if __name__ == "__main__":
    assert len(sys.argv) == 1, sys.argv
    sys.exit(run.main(lambda: ManagedNode("oven")))
"""


@pytest.fixture
def lab(tmp_path, monkeypatch):
    """``lab(name=text)``: executables of the package ``lab``."""
    folder = tmp_path / "lib" / "lab"
    folder.mkdir(parents=True)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))

    def write(**programs):
        for name, content in programs.items():
            path = folder / name
            path.write_bytes(content if isinstance(content, bytes) else content.format(python=sys.executable).encode())
            path.chmod(0o755)

    return write


def test_each_executable_gives_its_node(lab, ros):
    lab(oven=ALONE, scale=ALONE.replace('"oven"', '"scale"'))
    arguments = list(sys.argv)
    programs = programs_of(["lab/oven", "lab/scale"])
    assert sys.argv == arguments
    nodes = [program.make_node() for program in programs]
    ros(*nodes)
    assert [node.get_name() for node in nodes] == ["oven", "scale"]


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("print('{python}')", "lab/oven cannot share a process: it runs 0 nodes by im_core.ros.run.main"),
        (ALONE.replace("sys.exit(", "print(") * 2, "lab/oven cannot share a process: it runs 2 nodes"),
        ("#!/bin/sh\nexec sleep 600\n", "oven cannot share a process: it is no Python program"),
        (b"\x7fELF\x02\x00\x00\xff", "oven cannot share a process: it is no Python program"),
    ],
)
def test_what_makes_no_node_in_python_cannot_share(lab, content, sentence):
    lab(oven=content)
    with pytest.raises(ConfigError, match=sentence):
        programs_of(["lab/oven"])


def test_an_executable_that_is_not_there_is_named(lab):
    lab(oven=ALONE)
    with pytest.raises(NotFoundError, match="there is no executable of lab 'ofen'; did you mean 'oven'"):
        programs_of(["lab/ofen"])
