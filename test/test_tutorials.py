"""The tutorials that are typed line by line: what stands below a line is what it prints."""

import re
import subprocess
from pathlib import Path

import pytest

from support.whole_machine import COMMAND_S, ROOT

TUTORIALS = ROOT / "docs" / "tutorials"
FILES = re.compile(r"^```\w+ (my/\S+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
TYPED = re.compile(r"^```console\n(.*?)^```$", re.DOTALL | re.MULTILINE)
#: Pages with a test of their own: of Python files, which are imported.
OTHERS = {"control_law.md", "servo_rate.md", "vision_service.md", "your_robot.md"}


def lines_of(page: str) -> list[tuple[str, list[str]]]:
    """Each line that is typed, with the lines that it prints."""
    typed: list[tuple[str, list[str]]] = []
    for line in "".join(TYPED.findall(page)).splitlines():
        if line.startswith("$ "):
            typed.append((line.removeprefix("$ "), []))
        else:
            typed[-1][1].append(line.strip())
    return typed


def is_printed(expected: list[str], output: str) -> bool:
    """Whether the lines are in an output, in their order; three dots stand for anything."""
    patterns = [".*".join(re.escape(part.strip()) for part in line.split("...")) for line in expected]
    return re.search(r"(?:.*\n)*?.*".join(patterns), output) is not None


def follow(name: str, folder: Path) -> None:
    """Do what a page says, with the folder in the place of the reader's own."""
    page = (TUTORIALS / name).read_text(encoding="utf-8")
    for file, text in FILES.findall(page):
        (folder / Path(file).name).write_text(text, encoding="utf-8")
    lines = lines_of(page)
    assert lines
    for line, expected in lines:
        code = re.search(r"# exit code (\d)", line)
        out = folder / "out.txt"
        # a file, not a pipe: what a line leaves in the background keeps that open
        with out.open("w") as printed:
            argv = ["bash", "-c", re.sub(r"(?<![\w/])my(?=/|$)", str(folder), line)]
            done = subprocess.run(
                argv, stdin=subprocess.DEVNULL, stdout=printed, stderr=printed, cwd=ROOT, timeout=COMMAND_S, check=False
            )
        told = out.read_text()
        assert done.returncode == (int(code[1]) if code else 0), f"$ {line}\n{told}"
        assert is_printed(expected, told), f"$ {line}\n{told}"


def test_each_tutorial_is_followed_by_a_test():
    assert {page.name for page in TUTORIALS.glob("*.md")} == OTHERS | {
        "net.md",
        "mission_test.md",
        "break_it.md",
        "cell.md",
    }


@pytest.mark.parametrize("name", ["net.md", "mission_test.md", "cell.md"])
def test_a_tutorial_without_a_machine_holds(name, tmp_path):
    follow(name, tmp_path)


@pytest.mark.end_to_end
def test_what_is_broken_mends_itself(tmp_path):
    try:
        follow("break_it.md", tmp_path)
    finally:
        subprocess.run(["scripts/stop.sh"], cwd=ROOT, capture_output=True, check=False)


def test_what_is_printed_is_compared_line_by_line():
    assert is_printed(["a ... c", "d"], "x\na b c\ny\nd\n")
    assert not is_printed(["d", "a ... c"], "x\na b c\ny\nd\n")
    assert is_printed(["..."], "")
    assert is_printed([], "")
