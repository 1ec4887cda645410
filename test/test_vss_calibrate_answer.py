"""What /vss/calibrate says where it cannot do what is proposed."""

from dataclasses import replace
from pathlib import Path

import pytest

from bench.calibration.synthetic import Design, make_scene
from im_calibration import calibrate
from im_calibration.judgement.calibration import Verdict
from im_vss.ros.ports.calibration import told
from im_vss.services.calibrate import CalibrateResult


@pytest.mark.parametrize(
    ("folder", "where"), [(Path("/r"), "/r/observations.json."), (None, "the observations, as a data set.")]
)
def test_another_lens_model_is_for_the_command(folder, where):
    good = calibrate(make_scene(Design(), 1).problem)
    assert told(CalibrateResult(good, {}, False, folder)) == good.message
    wide = replace(good, verdicts=(Verdict("MISFIT", (), "It does not fit.", "Take it.", "equidistant"),))
    said = told(CalibrateResult(wide, {}, False, folder))
    assert said.startswith(wide.message)
    assert said.endswith(f"The Service calibrate makes plumb_bob only: use the command calibrate_dataset on {where}")
