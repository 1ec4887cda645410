"""The prints on free bodies are fiducials that can be asked for, beside the plates of the cell."""

from types import SimpleNamespace

import pytest

from im_cell.robot import load_cell
from im_core.config import package_file
from im_core.errors import NotFoundError
from im_vss.services.features import SvcFiducialPose


def test_prints_of_free_bodies_are_wanted_with_the_plates(monkeypatch):
    monkeypatch.setenv("IM_OBJECTS", str(package_file("im_cell", "cells/puma_pair/objects.yaml")))
    service = SvcFiducialPose.__new__(SvcFiducialPose)
    service.rig = SimpleNamespace(cell=load_cell())
    found = service._wanted(())
    names = {number: each.name for number, each in found.items()}
    assert {7: "table_tag", 21: "tagged_block", 22: "tagged_plate"}.items() <= names.items()
    assert found[22].size == 0.1
    assert found[22].position[2] == pytest.approx(0.77), "its upper face"
    with pytest.raises(NotFoundError, match="'13'"):
        service._wanted((13,))
