"""Print how many tests of a JUnit file passed and failed; a skipped test has not passed."""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ElementTree


def counts(path: str) -> tuple[int, int]:
    """Numbers of passed and of failed tests, skipped ones among the latter."""
    total = failed = 0
    for suite in ElementTree.parse(path).getroot().iter("testsuite"):
        total += int(suite.get("tests", 0))
        failed += sum(int(suite.get(kind, 0)) for kind in ("failures", "errors", "skipped"))
    return max(0, total - failed), failed


if __name__ == "__main__":
    print(*counts(sys.argv[1]))
