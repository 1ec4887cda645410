"""First lines of docstrings are read once: few pronouns, and hardly a clause with who or what (shares by package)."""

import ast
import re
from pathlib import Path

import pytest

SOURCES = Path(__file__).resolve().parent.parent / "ros_ws" / "src"
PACKAGES = sorted(path.name for path in SOURCES.iterdir() if (path / path.name / "__init__.py").is_file())

PRONOUN = re.compile(
    r"\b(it|its|itself|he|him|his|himself|they|them|their|theirs|themselves|this|that|these|those)\b", re.IGNORECASE
)
WHO = re.compile(r"\b(who|whom|whose|whoever|what|whatever)\b", re.IGNORECASE)

#: Largest shares of first lines with a pronoun, and with a clause of who or what.
PRONOUNS, CLAUSES = 0.10, 0.01


def first_lines(package):
    """First docstring lines of the modules, classes and functions of a package, each with file and line."""
    for path in sorted((SOURCES / package / package).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                text = ast.get_docstring(node)
                if text:
                    yield f"{path.relative_to(SOURCES)}:{node.body[0].lineno}", text.split("\n")[0]


@pytest.mark.parametrize("package", PACKAGES)
@pytest.mark.parametrize(("words", "share"), [(PRONOUN, PRONOUNS), (WHO, CLAUSES)], ids=["pronouns", "who and what"])
def test_first_lines_of_docstrings_are_plain(package, words, share):
    lines = list(first_lines(package))
    found = [f"{place}: {line}" for place, line in lines if words.search(line)]
    assert len(found) <= share * len(lines), found


def test_words_are_found():
    assert PRONOUN.search("Time goes on without him.")
    assert WHO.search("Who was awaited has not come.")
    assert not PRONOUN.search("Resume simulated time: the awaited owner sent no request.")
    assert not WHO.search("Return whether the servo runs.")
