"""Words of class and module names are terms of the glossary, or plain English (docs/glossary.md)."""

import ast
import functools
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
GLOSSARY = ROOT / "docs" / "glossary.md"
PLAIN = "## Plain words"


def words(text):
    """Lower-case words of a text, or of a name in camel or snake case."""
    return {word.lower() for word in re.findall(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+|\d+", text)}


@functools.cache
def names():
    """Names of all modules and classes of the packages, each with its file."""
    found = []
    sources = ROOT / "ros_ws" / "src"
    for path in sorted([*sources.glob("im_*/im_*/**/*.py"), *sources.glob("im_*/im_*/**/*.pyi")]):
        package, top, *_ = path.relative_to(ROOT / "ros_ws" / "src").parts
        if package != top:
            continue
        if not path.stem.startswith("__"):
            found.append((path, path.stem))
        tree = ast.parse(path.read_text(encoding="utf-8"))
        found += [(path, node.name) for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
    return found


def test_names_have_words_of_the_glossary():
    known = words(GLOSSARY.read_text(encoding="utf-8"))
    known |= {f"{word}s" for word in known}
    unknown = {f"{path.name}: {name}": sorted(missing) for path, name in names() if (missing := words(name) - known)}
    assert not unknown, "add the term to docs/glossary.md, or choose a name of known words"


def test_plain_words_are_in_use():
    used = set().union(*(words(name) for _, name in names()))
    used |= {word.removesuffix("s") for word in used}
    plain = GLOSSARY.read_text(encoding="utf-8").partition(PLAIN)[2].rstrip().rpartition("\n\n")[2]
    assert words(plain)
    assert not words(plain) - used


def test_names_are_split_into_words():
    assert words("ToolSpotFind") == words("tool_spot_find") == {"tool", "spot", "find"}
    assert words("QoSProfile") == {"qo", "s", "profile"}
    assert words("IK3x6") == {"ik", "3", "x", "6"}
