"""Data sets from text and matrices of OpenCV: what is written is read back, what is wrong is named with its line."""

import json

import cv2
import numpy as np
import pytest

from bench.calibration.target_views import make_views
from im_calibration.commands import command, make_dataset
from im_calibration.problem.convert import read_opencv
from im_calibration.problem.dataset import load_problems
from im_calibration.targets.target import target_of

RNG = np.random.default_rng(1)
POSITIONS = RNG.uniform(-300.0, 300.0, (12, 3)).round(3)
SPOTS = {name: RNG.uniform(0.0, 1000.0, (12, 2)).round(3) for name in ("left", "right")}
SEEN = {"left": np.arange(10), "right": np.arange(2, 12)}


def written_as_text(folder):
    for name, seen in SEEN.items():
        rows = np.column_stack((SPOTS[name][seen], POSITIONS[seen]))
        lines = [", ".join(map(str, row)) for row in rows.tolist()]
        (folder / name).write_text("# u v x y z\n\n" + "\n".join(lines) + "\n")
    return ["text"], ["--image-size", "1280x1024"]


def written_by_opencv(folder):
    for name, seen in SEEN.items():
        storage = cv2.FileStorage(str(folder / f"{name}.yml"), cv2.FILE_STORAGE_WRITE)
        storage.write("image_width", 1280)
        storage.write("image_height", 1024)
        storage.write("calibration_time", "today")
        storage.write("image_points", SPOTS[name][seen])
        storage.write("object_points", POSITIONS[seen])
        storage.release()
        (folder / f"{name}.yml").rename(folder / name)
    return ["opencv"], []


@pytest.mark.parametrize("write", [written_as_text, written_by_opencv])
def test_what_is_written_is_read_back(write, tmp_path, capsys):
    first, last = write(tmp_path)
    target = tmp_path / "out.json"
    named = [f"{name}={tmp_path / name}" for name in SEEN]
    options = ["--unit", "mm", "--sigma-px", "0.2", "--sigma-position", "0.5"]
    assert make_dataset.main([*first, *named, str(target), *options, *last]) == command.OK
    assert "12 positions, 10 spots of left, 10 spots of right" in capsys.readouterr().out
    (problem,) = load_problems(target)
    assert problem.camera_names == ("left", "right")
    assert problem.image_sizes == ((1280, 1024),) * 2
    np.testing.assert_allclose(problem.positions, 1e-3 * POSITIONS, rtol=1e-12)
    for c, (name, seen) in enumerate(SEEN.items()):
        np.testing.assert_array_equal(np.flatnonzero(problem.detected[c]), seen)
        np.testing.assert_array_equal(problem.spots[c][seen], SPOTS[name][seen])
    np.testing.assert_allclose(problem.spot_covariances[0, 0], 0.04 * np.eye(2))
    np.testing.assert_allclose(problem.position_covariances[0], 25e-8 * np.eye(3))
    assert problem.noise_to_estimate == ()


def test_noise_that_is_not_given_is_to_be_estimated_and_places_may_come_again(tmp_path):
    (tmp_path / "a").write_text("1 2 0 0 0\n3 4 0 0 0  # again\n5 6 1 0 0\n")
    target = tmp_path / "out.json"
    assert make_dataset.main(["text", f"a={tmp_path / 'a'}", str(target), "--image-size", "8x8"]) == command.OK
    assert json.loads(target.read_text())["sigma_u_px"] is None
    (problem,) = load_problems(target)
    assert problem.noise_to_estimate == ("image", "robot")
    np.testing.assert_array_equal(problem.spots[0], [[1, 2], [3, 4], [5, 6]])


MATRIX = (
    "%YAML:1.0\n---\nimage_points: !!opencv-matrix\n   rows: 2\n   cols: 2\n   dt: d\n   data: [ 1., 2., 3., 4. ]\n"
)
POINTS = "object_points: !!opencv-matrix\n   rows: 2\n   cols: 3\n   dt: d\n   data: [ 1., 2., 3., 4., 5., {} ]\n"
THREE = POINTS.format("6., 7., 8., 9.").replace("rows: 2", "rows: 3")
HOMOGENEOUS = POINTS.format("6., 7., 1.").replace("cols: 3", "cols: 4")
TRANSPOSED = MATRIX.replace("cols: 2", "cols: 3").replace("3., 4.", "3., 4., 5., 6.")


@pytest.mark.parametrize("shape", [(10, 1), (1, 10), (2, 5)])
def test_points_as_elements_of_two_and_three_numbers_are_read(shape, tmp_path):
    storage = cv2.FileStorage(str(tmp_path / "a.yml"), cv2.FILE_STORAGE_WRITE)
    storage.write("image_points", SPOTS["left"][:10].reshape(*shape, 2))
    storage.write("object_points", POSITIONS[:10].reshape(*shape, 3))
    storage.release()
    found = read_opencv(tmp_path / "a.yml")
    np.testing.assert_array_equal(found.spots, SPOTS["left"][:10])
    np.testing.assert_array_equal(found.positions, POSITIONS[:10])


@pytest.mark.parametrize(
    ("kind", "text", "sentence"),
    [
        ("text", "1 2 3 4 5\n1 2 3 4\n", "a:2: 4 numbers, the 5 of u v x y z are needed"),
        ("text", "1 2 3 4 five\n", "a:1: '1 2 3 4 five' is not five numbers"),
        ("text", "\n1 2 3 4 nan\n", "a:2: a number is not finite"),
        ("text", "# nothing\n", "a: holds no line u v x y z"),
        ("text", "1 2 3 4 5\n", "The image size of a is not known; give --image-size"),
        ("opencv", MATRIX, "a:3: object_points: "),
        (
            "opencv",
            MATRIX + POINTS.format("6., 7."),
            "a:12: object_points.data: has 7 numbers, the 6 of 2 x 3 of dt d are needed",
        ),
        ("opencv", MATRIX + POINTS.format("6.").replace("rows: 2", "rows: 3"), "has 6 numbers, the 9 of 3 x 3"),
        ("opencv", MATRIX + THREE, "holds 3 points, image_points holds 2"),
        (
            "opencv",
            TRANSPOSED + THREE,
            "a:5: image_points.cols: is 2 x 3 of dt d; n x 2, or elements of 2 (dt 2f), are",
        ),
        ("opencv", MATRIX + HOMOGENEOUS, "a:10: object_points.cols: is 2 x 4 of dt d; n x 3, or elements of 3 (dt 3f)"),
        ("opencv", MATRIX.replace("dt: d", "dt: 2if") + THREE, "a:6: image_points.dt: "),
        ("opencv", MATRIX + POINTS.format("six"), "a:12: object_points.data[5]: "),
        ("opencv", "%YAML:1.0\n---\nimage_points: [", "a:3: not YAML"),
    ],
)
def test_what_is_wrong_with_a_file_is_named_with_its_line(kind, text, sentence, tmp_path, capsys):
    (tmp_path / "a").write_text(text)
    target = tmp_path / "out.json"
    assert make_dataset.main([kind, f"a={tmp_path / 'a'}", str(target)]) == command.BAD_INPUT
    assert sentence in capsys.readouterr().err
    assert not target.exists()


def test_files_and_arguments_that_cannot_be_used_are_named(tmp_path, capsys):
    assert make_dataset.main(["text", f"a={tmp_path}", "out.json"]) == command.BAD_INPUT
    assert "not a regular file" in capsys.readouterr().err
    for wrong in (["a"], ["a=b", "--image-size", "12"], ["a=b", "--sigma-px", "0"]):
        with pytest.raises(SystemExit) as end:
            make_dataset.main(["text", wrong[0], "out.json", *wrong[1:]])
        assert end.value.code == 2


def test_what_is_read_is_not_written_over(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for name in ("a.txt", "b.txt"):
        (tmp_path / name).write_text("0 0 0 1 1\n")
    assert make_dataset.main(["text", "a=a.txt", "a.txt"]) == command.BAD_INPUT
    assert "a.txt: it is one of the files that are read" in capsys.readouterr().err
    assert make_dataset.main(["text", "a=a.txt", "b=b.txt"]) == command.BAD_INPUT
    assert "b=b.txt: the file to write comes last; this names a camera" in capsys.readouterr().err
    assert (tmp_path / "a.txt").read_text() == "0 0 0 1 1\n"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.txt", "b.txt"]


def test_what_the_sample_of_opencv_writes_is_read(tmp_path, capsys):
    views = make_views("two cameras", 1, target=target_of("chessboard:5x4:45mm"), count=8).views
    spots = np.where(np.isfinite(views.spots), views.spots, 5000.0)
    for name, camera in zip(("left", "right"), spots, strict=True):
        storage = cv2.FileStorage(str(tmp_path / f"{name}.yml"), cv2.FILE_STORAGE_WRITE)
        for key, value in (("image_width", 640), ("image_height", 480), ("board_width", 5), ("board_height", 4)):
            storage.write(key, value)
        storage.write("square_size", 45.0)
        storage.write("image_points", camera.astype(np.float32))
        storage.release()
    cameras = [f"{name}={tmp_path / name}.yml" for name in ("left", "right")]
    assert make_dataset.main(["opencv", *cameras, str(tmp_path / "out.json"), "--unit", "mm"]) == command.OK
    (problem,) = load_problems(tmp_path / "out.json")
    assert problem.camera_names == ("left", "right")
    assert problem.placements.count == 8
    np.testing.assert_allclose(problem.spots, spots.reshape(2, -1, 2), atol=1e-3)
    text = (tmp_path / "left.yml").read_text().replace("board_width: 5", "board_width: 6")
    (tmp_path / "left.yml").write_text(text)
    assert make_dataset.main(["opencv", *cameras, str(tmp_path / "out.json")]) == command.BAD_INPUT
    assert "is 8 x 20 of dt 2f; a row of 24 elements of 2 for each view is needed" in capsys.readouterr().err
