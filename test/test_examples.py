"""The examples in the docstrings of four packages hold, and the notebook that needs no machine."""

import doctest
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

from support.notebook import source_of
from support.whole_machine import COMMAND_S, ROOT


@pytest.mark.parametrize("package", ["im_calibration", "im_cell", "im_pnt", "im_pnt_analysis"])
def test_examples_of_a_package_hold(package):
    """The package's own example comes first; those of its names go on with the variables of that one."""
    face = importlib.import_module(package)
    folder = Path(face.__file__).parent
    runner = doctest.DocTestRunner()
    own = doctest.DocTestParser().get_doctest(face.__doc__, {}, package, face.__file__, 0)
    runner.run(own, clear_globs=False)
    for path in sorted(folder.rglob("*.py")):
        if ">>> " in path.read_text() and path != folder / "__init__.py":
            parts = path.relative_to(folder.parent).with_suffix("").parts
            module = importlib.import_module(".".join(parts).removesuffix(".__init__"))
            for example in doctest.DocTestFinder().find(module, extraglobs=own.globs):
                runner.run(example)
    assert runner.failures == 0, "see the captured output"
    assert runner.tries >= 10


def test_the_notebook_of_nets_runs_from_its_first_cell_to_its_last():
    source = source_of(ROOT / "examples" / "nets.ipynb")
    argv = [sys.executable, "-c", source]
    done = subprocess.run(argv, capture_output=True, text=True, timeout=COMMAND_S, check=False)
    assert done.returncode == 0, done.stderr
    said = done.stdout.splitlines()
    assert "verified 3 markings {'cold': 1, 'full': 1, 'hot': 1}" in said
    assert "refused" in said
