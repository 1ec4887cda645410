"""Chi-squared distribution: equal to that of scipy.stats, which no calibration imports."""

import subprocess
import sys

import numpy as np
import pytest
from scipy import stats

from im_calibration.estimation.chi_squared import chi2_beyond, chi2_limit, chi2_median


@pytest.mark.parametrize("dof", [1, 2, 7.5, 80])
def test_values_are_those_of_scipy_stats(dof):
    values = np.array([0.0, 0.3, 4.0, 120.0, 2000.0])
    assert chi2_beyond(values, dof) == pytest.approx(stats.chi2.sf(values, dof), rel=1e-12)
    for chance in (1e-6, 0.05, 0.5):
        assert chi2_limit(chance, dof) == pytest.approx(stats.chi2.isf(chance, dof), rel=1e-12)
    assert chi2_median(dof) == pytest.approx(stats.chi2.median(dof), rel=1e-12)


def test_a_calibration_does_not_import_scipy_stats():
    code = "import sys, im_calibration.pipeline, im_calibration.reporting.plots; sys.exit('scipy.stats' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
