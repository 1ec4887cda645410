"""No text that a user reads names a command that this installation lacks."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
GUIDES = sorted(page for folder in (".", "tutorials") for page in (ROOT / "docs" / folder).glob("*.md"))
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *GUIDES,
]
SOURCES = sorted(
    path
    for suffix in ("py", "yaml", "html", "js", "msg", "srv", "action")
    for path in (ROOT / "ros_ws" / "src").rglob(f"*.{suffix}")
    if "test" not in path.parts
)
SCRIPTS = sorted(path for path in (ROOT / "scripts").iterdir() if path.suffix in ("", ".sh", ".py") and path.is_file())
TEXTS = [*PAGES, *SOURCES, *SCRIPTS]
SUBCOMMANDS = set(re.findall(r"^  \[(\w+)\]=", (ROOT / "scripts" / "im").read_text(), re.MULTILINE))
#: The command line of ROS is not in the wheels; a page that names it says so, and names ours where there is one.
ROS2 = re.compile(r"(?<![\w./-])ros2 (?:bag|launch|topic|service|action|param|lifecycle|node|run)\b")
OURS = re.compile(r"(?<![\w./-])ros2 (?:topic|service|action|param|lifecycle|node)\b")
PNT = re.compile(r"(?<![\w./-])(?<!im )(?<!im_pnt_analysis )pnt (?:verify|simulate|time|convert|draw|schema|journal)\b")


def executables(package):
    """Console scripts of a package, as its setup declares them."""
    setup = ROOT / "ros_ws" / "src" / package / "setup.py"
    return set(re.findall(r'"(\w+) ?= ?[\w.]+:\w+"', setup.read_text())) if setup.exists() else set()


def found(path, pattern):
    """Where a text matches: its place, and the match."""
    text = path.read_text(encoding="utf-8").splitlines()
    return [
        (f"{path.relative_to(ROOT)}:{number}: {match[0]}", match)
        for number, line in enumerate(text, start=1)
        # the docstring of a module is for those who have the source before them
        if path.suffix != ".py" or number > 1
        for match in re.finditer(pattern, line)
    ]


def in_texts(pattern):
    return [hit for path in TEXTS for hit in found(path, pattern)]


def test_every_script_subcommand_and_executable_that_is_named_is_there():
    missing = [at for at, m in in_texts(r"scripts/(\w+\.(?:sh|py))") if not (ROOT / "scripts" / m[1]).is_file()]
    missing += [at for at, m in in_texts(r"scripts/im ([a-z]+)") if m[1] not in SUBCOMMANDS]
    missing += [at for at, m in in_texts(r"scripts/run\.sh (im_\w+) ([a-z]\w+)") if m[2] not in executables(m[1])]
    assert missing == []


def test_pnt_is_named_as_it_is_called():
    assert [at for at, _ in in_texts(PNT)] == []


def test_no_page_sends_to_the_command_line_of_ros_for_what_ours_does():
    assert [at for page in PAGES for at, _ in found(page, OURS)] == []


def test_the_command_line_of_ros_is_named_on_pages_only_and_said_to_be_elsewhere():
    assert [at for path in TEXTS if path not in PAGES for at, _ in found(path, ROS2)] == []
    pages = [page for page in PAGES if found(page, ROS2)]
    assert [page for page in pages if "the wheels have no `ros2` command" not in page.read_text(encoding="utf-8")] == []
