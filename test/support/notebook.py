"""Notebooks (nbformat 4) as programs: a test runs them without Jupyter."""

import json
from pathlib import Path


def source_of(path: Path) -> str:
    """The code cells of a notebook, in order, as one program; the outputs that it is stored with are none."""
    book = json.loads(path.read_text(encoding="utf-8"))
    assert book["nbformat"] == 4
    cells = [cell for cell in book["cells"] if cell["cell_type"] == "code"]
    assert not any(cell["outputs"] for cell in cells), "clear the outputs"
    return "\n".join("".join(cell["source"]) for cell in cells)
