"""Fixtures of the tests of the solver and of its commands."""

import pytest

from im_calibration.reporting import results


@pytest.fixture(scope="module")
def without_pictures():
    """Results without pictures, which take as long as the calibration; those of ``test_report.py`` have them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(results, "_pictures", lambda calibration, problem, shown: {})
        yield
