"""The examples in the docstrings of four packages hold: what a reader types first."""

import doctest
import importlib
from pathlib import Path

import pytest


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
