"""``start`` reads the calibrations it is given before anything is started."""

import pytest

from im_bringup.machine import start
from im_bringup.tasks import deployment as deployments
from im_cell.calibration_files import EXTRINSICS, CameraPose, extrinsics_yaml
from im_cell.robot import load_cell
from im_core.errors import ConfigError

MACHINE = """\
calibration: "%s"
hosts:
  %s:
    vss:
      vss: {package: im_vss, executable: vss, node: /vss, parameters: {calibration: "${calibration}"}}
"""
POSE = CameraPose("world", *load_cell().cameras["wall"].pose())


@pytest.fixture
def calibrated(tmp_path):
    """A folder with the pose of a camera."""
    folder = tmp_path / "calibrated"
    folder.mkdir()
    (folder / EXTRINSICS).write_text(extrinsics_yaml({"wall": POSE}))
    return folder


@pytest.fixture
def deployment_file(tmp_path):
    """``deployment_file(calibration, host)``: a file in a folder beside ``calibrated``."""

    def write(calibration="", host="localhost"):
        path = tmp_path / "deployments" / "d.yaml"
        path.parent.mkdir(exist_ok=True)
        path.write_text(MACHINE % (calibration, host))
        return path

    return write


def run(monkeypatch, *arguments):
    """What ``start`` answers up to where it would start the machine; there 99."""
    monkeypatch.setattr("sys.argv", ["start", *map(str, arguments)])
    monkeypatch.setattr(start, "start", lambda *_: 99)
    return start.main()


def test_the_folder_of_a_file_is_relative_to_it(calibrated, deployment_file):
    loaded = deployments.load(deployment_file("../calibrated"))
    assert loaded.calibration == str(calibrated)
    (vss,) = loaded.tasks()
    assert loaded.parameters_of(vss.task)["calibration"] == str(calibrated)
    assert deployments.load(deployment_file("")).calibration == ""


def test_the_command_line_goes_before_the_file(calibrated, deployment_file, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run(monkeypatch, deployment_file("../none"), "--calibration", "calibrated") == 99
    assert capsys.readouterr().out == f"start: vss starts with {calibrated}: wall (pose)\n"


def test_as_drawn_unless_asked(deployment_file, monkeypatch, capsys):
    assert run(monkeypatch, deployment_file()) == 99
    assert capsys.readouterr().out == ""
    assert deployments.load(deployments.default_path()).calibration == ""


def test_latest_is_fixed_at_the_start(calibrated, tmp_path, monkeypatch):
    """A task that is started again later must not read another folder."""
    (tmp_path / "latest").symlink_to("calibrated")
    arguments = start.parser().parse_args(["--calibration", str(tmp_path / "latest")])
    assert arguments.calibration == str(calibrated)


def test_wrong_folders_are_bad_input(calibrated, deployment_file, tmp_path, monkeypatch, capsys):
    assert run(monkeypatch, deployment_file("../none")) == 2
    assert f"start: {tmp_path}/none: no calibration: there is no such folder\n" in capsys.readouterr().err
    (calibrated / EXTRINSICS).write_text(
        extrinsics_yaml({"wall": CameraPose("table", POSE.R_cam_base, POSE.t_cam_base)})
    )
    assert run(monkeypatch, deployment_file(), "--calibration", calibrated) == 2
    said = capsys.readouterr().err
    assert f"start: {calibrated}/extrinsics.yaml:2: transforms[0].header.frame_id: 'table': wall is fixed to w" in said
    with pytest.raises(SystemExit, match="2"):
        run(monkeypatch, deployment_file(), "--calibration", "")
    assert "--calibration: the name of a folder is needed" in capsys.readouterr().err


def test_a_calibration_that_nobody_takes_is_refused(calibrated, deployment_file):
    path = deployment_file("../calibrated")
    path.write_text(path.read_text().replace("${calibration}", "elsewhere"))
    with pytest.raises(ConfigError, match=r"no task has '\${calibration}' among its parameters"):
        start.check_calibration(deployments.load(path), path)


def test_other_hosts_know_the_file_only(calibrated, deployment_file):
    path = deployment_file("", "far")
    given = deployments.load(path).with_values(calibration=str(calibrated))
    with pytest.raises(ConfigError, match=r"vss is on host far, which reads .*d\.yaml; write the folder there"):
        start.check_calibration(given, path)
    path = deployment_file("../only_there", "far")
    start.check_calibration(deployments.load(path), path)
