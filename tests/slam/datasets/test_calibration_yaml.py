"""The calibration files of OpenCV, Kalibr, ROS and ORB-SLAM describe the same rig as camera.toml does."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from odometry import se3
from slam.datasets.calibration_yaml import find_calibration, read_yaml
from slam.datasets.camera_toml import CameraToml
from slam.datasets.dataset import DatasetSpec
from slam.datasets.distortion_models import CameraModel
from slam.datasets.formats.euroc import read_sensor_yaml
from slam.datasets.formats.registry import open_dataset, open_images
from slam.errors import DataError

from .layouts import RATE, BagStyle, Taken, taken, write_bag, write_euroc, write_folders
from .rig import RIGS, SIZE, Rig


def coefficients(model: CameraModel) -> list[float]:
    return list(model.coefficients or (0.0,) * 4)


def opencv_file(path: Path, values: dict[str, object]) -> None:
    """Write values by OpenCV itself."""
    file = cv2.FileStorage(str(path), cv2.FileStorage_WRITE)
    for name, value in values.items():
        file.write(name, np.array(value, np.float64) if isinstance(value, list | np.ndarray) else value)
    file.release()


def pose_parts(rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    T_right_left = se3.inverse(rig.T_left_right)
    return T_right_left[:3, :3], T_right_left[:3, 3:]


def write_opencv(folder: Path, rig: Rig) -> None:
    R, t = pose_parts(rig)
    values = {"M1": rig.left.K, "D1": [coefficients(rig.left)], "M2": rig.right.K, "D2": [coefficients(rig.right)]}
    opencv_file(folder / "stereo.yml", {**values, "R": R, "T": t, "image_width": SIZE[0], "image_height": SIZE[1]})


def write_opencv_in_two_files(folder: Path, rig: Rig) -> None:
    """As OpenCV's example program stereo_calib does."""
    R, t = pose_parts(rig)
    values = {"M1": rig.left.K, "D1": [coefficients(rig.left)], "M2": rig.right.K, "D2": [coefficients(rig.right)]}
    opencv_file(folder / "intrinsics.yml", values)
    opencv_file(folder / "extrinsics.yml", {"R": R, "T": t, "R1": np.eye(3), "R2": np.eye(3)})


def write_other_names(folder: Path, rig: Rig) -> None:
    R, t = pose_parts(rig)
    opencv_file(
        folder / "calibration.yaml",
        {
            "cameraMatrix1": rig.left.K, "distCoeffs1": [coefficients(rig.left)],
            "cameraMatrix2": rig.right.K, "distCoeffs2": [coefficients(rig.right)], "R": R, "T": t,
        },
    )  # fmt: skip


def write_kalibr(folder: Path, rig: Rig) -> None:
    T = se3.inverse(rig.T_left_right)
    lines = []
    for number, model in enumerate((rig.left, rig.right)):
        lines += [
            f"cam{number}:",
            "  cam_overlaps: [1]",
            "  camera_model: pinhole",
            f"  distortion_coeffs: {coefficients(model)}",
            f"  distortion_model: {'equidistant' if model.is_fisheye else 'radtan'}",
            f"  intrinsics: {[model.fx, model.fy, model.cx, model.cy]}",
            f"  resolution: {list(SIZE)}",
            f"  rostopic: /stereo/{('left', 'right')[number]}/image_raw",
        ]
    lines += ["  T_cn_cnm1:", *(f"  - {row.tolist()}" for row in T)]
    (folder / "camchain-drive.yaml").write_text("\n".join(lines) + "\n")


def write_kalibr_with_imu(folder: Path, rig: Rig) -> None:
    write_kalibr(folder, rig)
    path = folder / "camchain-drive.yaml"
    before, _, _ = path.read_text().partition("  T_cn_cnm1")
    T_left_imu = se3.exp(np.array([0.1, -0.2, 0.3, 1.0, 2.0, 3.0]))
    T_right_imu = se3.inverse(rig.T_left_right) @ T_left_imu
    first, second = before.split("cam1:")
    poses = ["\n".join(["  T_cam_imu:", *(f"  - {row.tolist()}" for row in T)]) for T in (T_left_imu, T_right_imu)]
    path.write_text(f"{first}{poses[0]}\ncam1:{second}{poses[1]}\n")


def write_ros(folder: Path, rig: Rig) -> None:
    """As camera_calibration does: the rectification instead of the pose."""
    size = cv2.stereoRectify(
        rig.left.K, np.array(coefficients(rig.left)), rig.right.K, np.array(coefficients(rig.right)), SIZE,
        *pose_parts(rig), alpha=0,
    )  # fmt: skip
    for number, (side, model) in enumerate((("left", rig.left), ("right", rig.right))):
        matrices = {
            "camera_matrix": model.K, "distortion_coefficients": np.array([coefficients(model)]),
            "rectification_matrix": size[number], "projection_matrix": size[2 + number],
        }  # fmt: skip
        lines = [f"image_width: {SIZE[0]}", f"image_height: {SIZE[1]}", f"camera_name: {side}"]
        lines += ["distortion_model: plumb_bob"]
        for name, m in matrices.items():
            lines += [f"{name}:", f"  rows: {m.shape[0]}", f"  cols: {m.shape[1]}", f"  data: {m.ravel().tolist()}"]
        (folder / f"{side}.yaml").write_text("\n".join(lines) + "\n")


def write_orb_slam(folder: Path, rig: Rig) -> None:
    lines = ["%YAML:1.0", "", 'File.version: "1.0"', 'Camera.type: "PinHole"']
    for number, model in enumerate((rig.left, rig.right), start=1):
        lines += [f"Camera{number}.{name}: {getattr(model, name)}" for name in ("fx", "fy", "cx", "cy")]
        names = zip(("k1", "k2", "p1", "p2", "k3"), coefficients(model), strict=False)
        lines += [f"Camera{number}.{name}: {value:.9f}" for name, value in names]
    numbers = ", ".join(map(str, rig.T_left_right.ravel().tolist()))
    lines += ["Stereo.T_c1_c2: !!opencv-matrix", "  rows: 4", "  cols: 4", "  dt: f", f"  data: [{numbers}]"]
    (folder / "EuRoC.yaml").write_text("\n".join([*lines, f"Camera.fps: {int(RATE)}", "Camera.RGB: 1"]) + "\n")


Write = Callable[[Path, Rig], None]
WRITERS: dict[str, Write] = {
    "OpenCV": write_opencv,
    "OpenCV in two files": write_opencv_in_two_files,
    "OpenCV's parameters": write_other_names,
    "Kalibr": write_kalibr,
    "Kalibr with an IMU": write_kalibr_with_imu,
    "ROS": write_ros,
    "ORB-SLAM": write_orb_slam,
}


@pytest.fixture(scope="module")
def rough() -> Taken:
    return taken("radtan", 3)


def found_in(folder: Path) -> CameraToml:
    calibration = find_calibration(folder)
    assert calibration is not None
    return calibration


@pytest.mark.parametrize("tool", WRITERS)
def test_the_pair_of_each_tool_is_the_rig(tmp_path: Path, rough: Taken, tool: str) -> None:
    WRITERS[tool](tmp_path, rough.rig)
    found = found_in(tmp_path)
    assert found.right_camera is not None
    np.testing.assert_allclose(found.right_camera.T_left_right, rough.rig.T_left_right, atol=1e-6)
    for model, expected in ((found.model, rough.rig.left), (found.right_camera.model, rough.rig.right)):
        np.testing.assert_allclose(model.K, expected.K, rtol=1e-9)
        np.testing.assert_allclose(model.coefficients[:4], expected.coefficients, atol=1e-9)
    assert any(found.path.name in remark for remark in found.remarks)


@pytest.mark.parametrize("tool", WRITERS)
def test_a_folder_of_images_with_the_file_of_a_tool_is_a_dataset(tmp_path: Path, rough: Taken, tool: str) -> None:
    folder = write_folders(tmp_path / "mine", rough, fps=RATE)
    expected = open_dataset(folder)
    (folder / "camera.toml").write_text(f"fps = {RATE}\n")  # beside camera.toml
    WRITERS[tool](folder, rough.rig)
    dataset = open_dataset(folder)
    assert dataset.has_right
    assert dataset.camera.baseline == pytest.approx(expected.camera.baseline, abs=1e-6)
    assert np.abs(dataset[1].left.astype(float) - expected[1].left).max() <= 2
    (folder / "camera.toml").unlink()  # instead of it
    dataset = open_dataset(DatasetSpec(folder, fps=RATE))
    assert np.abs(dataset[1].left.astype(float) - expected[1].left).max() <= 2
    assert np.array_equal(open_images(DatasetSpec(folder, fps=RATE))[1], dataset[1].left)


@pytest.mark.parametrize("tool", ["OpenCV", "Kalibr"])
def test_a_bag_without_camera_info_takes_the_file_beside_it(tmp_path: Path, rough: Taken, tool: str) -> None:
    path = write_bag(tmp_path, rough, BagStyle(infos=False))
    WRITERS[tool](tmp_path, rough.rig)
    dataset = open_dataset(path)
    assert dataset.camera.baseline == pytest.approx(np.linalg.norm(rough.rig.T_left_right[:3, 3]))
    assert np.abs(dataset[1].left.astype(float) - rough.ideal.left(rough.pairs[1][0])).max() <= 2


def test_a_file_comes_before_camera_info_if_it_names_topics_of_the_bag(tmp_path: Path, rough: Taken) -> None:
    path = write_bag(tmp_path, rough, BagStyle())
    other = Rig(rough.rig.left, rough.rig.right, rough.rig.T_left_right.copy())
    other.T_left_right[:3, 3] *= 2
    baseline = float(np.linalg.norm(rough.rig.T_left_right[:3, 3]))
    write_opencv(tmp_path, other)
    assert open_dataset(path).camera.baseline == pytest.approx(baseline)
    (tmp_path / "stereo.yml").unlink()
    write_kalibr(tmp_path, other)
    dataset = open_dataset(path)
    assert dataset.camera.baseline == pytest.approx(2 * baseline)
    assert any("calibration of camchain-drive.yaml" in remark for remark in dataset.remarks)


@pytest.mark.parametrize("count", [4, 5, 8, 12, 14])
def test_one_camera_of_opencv_has_any_count_of_coefficients(tmp_path: Path, count: int) -> None:
    D = [-0.3, 0.08, 0.002, -0.001, 0.01, 0.02, -0.01, 0.001, 0.002, 0.001, -0.002, 0.001, 0.02, -0.01][:count]
    opencv_file(tmp_path / "cam.yml", {"camera_matrix": RIGS["radtan"].left.K, "distortion_coefficients": [D]})
    found = found_in(tmp_path)
    assert not found.is_pair
    assert found.model.coefficients == pytest.approx(tuple(D))
    (tmp_path / "cam.yml").unlink()
    numbers = "fx = 200\nfy = 201\ncx = 163\ncy = 117\n"
    for model in ("radtan", "rational", "plumb_bob", "rational_polynomial"):
        (tmp_path / "camera.toml").write_text(f'{numbers}model = "{model}"\ndistortion = {D}\n')
        assert found_in(tmp_path).model.coefficients == pytest.approx(tuple(D))


def test_a_fisheye_lens_stays_one(tmp_path: Path) -> None:
    rig = RIGS["fisheye"]
    write_kalibr(tmp_path, rig)
    assert found_in(tmp_path).model == rig.left
    (tmp_path / "camchain-drive.yaml").unlink()
    values = {"camera_matrix": rig.left.K, "distortion_coefficients": [coefficients(rig.left)], "fisheye_model": 1}
    opencv_file(tmp_path / "cam.yml", values)
    assert found_in(tmp_path).model.is_fisheye


def test_settings_of_orb_slam_give_the_baseline_of_a_rectified_pair(tmp_path: Path) -> None:
    lines = "%YAML:1.0\n---\nCamera.fx: 718.856\nCamera.fy: 718.856\nCamera.cx: 607.1928\nCamera.cy: 185.2157\n"
    lines += "Camera.k1: 0.0\nCamera.k2: 0.0\nCamera.p1: 0.0\nCamera.p2: 0.0\nCamera.fps: 10.0\n"
    (tmp_path / "KITTI00-02.yaml").write_text(f"{lines}Camera.bf: 386.1448\n")
    assert (found_in(tmp_path).baseline_m, found_in(tmp_path).fps) == (pytest.approx(0.537166, abs=1e-6), 10.0)
    (tmp_path / "KITTI00-02.yaml").write_text(f"{lines}Camera.bf: 40.0\nDepthMapFactor: 5000.0\n")
    assert not found_in(tmp_path).is_pair


def test_what_camera_toml_says_about_cameras_counts(tmp_path: Path) -> None:
    write_opencv(tmp_path, RIGS["radtan"])
    (tmp_path / "camera.toml").write_text("fx = 100\nfy = 100\ncx = 50\ncy = 50\n")
    assert (found_in(tmp_path).path.name, found_in(tmp_path).model.fx) == ("camera.toml", 100.0)


def test_other_files_are_no_calibration(tmp_path: Path) -> None:
    (tmp_path / "params.yaml").write_text("robot:\n  speed: 3\nk1: 0.1\n")
    (tmp_path / "broken.yaml").write_text("a: [")
    (tmp_path / "list.yml").write_text("- 1\n- 2\n")
    assert find_calibration(tmp_path) is None


FAULTS: dict[str, tuple[Callable[[str], str], str]] = {
    "another model": (lambda t: t.replace("pinhole", "omni"), r"expected the camera_model pinhole, found 'omni'"),
    "three intrinsics": (lambda t: t.replace("200.0, ", "", 1), r"expected 4 numbers intrinsics, found 3"),
    "no pose": (lambda t: t.partition("  T_cn_cnm1")[0], r"expected 4 x 4 numbers T_cn_cnm1 or T_cam_imu, found None"),
    "images of another size": (
        lambda t: t.replace(str(list(SIZE)), "[752, 480]"),
        r"camchain-drive.yaml: expected images of 752 x 480, found 320 x 240; calibrate images of this size",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_of_a_calibration_are_named(tmp_path: Path, rough: Taken, fault: str) -> None:
    folder = write_folders(tmp_path / "mine", rough)
    (folder / "camera.toml").write_text(f"fps = {RATE}\n")
    write_kalibr(folder, rough.rig)
    change, message = FAULTS[fault]
    path = folder / "camchain-drive.yaml"
    path.write_text(change(path.read_text()))
    with pytest.raises(DataError, match=message):
        open_dataset(folder)


def test_two_calibrations_are_not_guessed_between(tmp_path: Path) -> None:
    write_opencv(tmp_path, RIGS["radtan"])
    write_kalibr(tmp_path, RIGS["radtan"])
    with pytest.raises(DataError, match=r"expected one calibration, found camchain-drive.yaml, stereo.yml; keep one"):
        find_calibration(tmp_path)


def test_the_pose_of_the_right_camera_is_asked_for(tmp_path: Path) -> None:
    K = RIGS["radtan"].left.K
    opencv_file(tmp_path / "intrinsics.yml", {"M1": K, "D1": [[0.0] * 5], "M2": K, "D2": [[0.0] * 5]})
    with pytest.raises(DataError, match=r"intrinsics.yml: expected R and T, the pose of the right camera"):
        find_calibration(tmp_path)


def test_a_matrix_of_opencv_is_read_in_sensor_yaml(tmp_path: Path, rough: Taken) -> None:
    root = write_euroc(tmp_path / "MH_01", rough)
    path = root / "mav0" / "cam0" / "sensor.yaml"
    before = read_sensor_yaml(path)
    text = path.read_text().replace("T_BS:\n", "T_BS: !!opencv-matrix\n").replace("  data:", "  dt: d\n  data:")
    path.write_text(f"%YAML:1.0\n---\n{text}")
    np.testing.assert_array_equal(read_sensor_yaml(path).T_body_camera, before.T_body_camera)
    assert len(open_dataset(root)) == 3


@pytest.mark.parametrize("count", [4, 5, 8, 12, 14])
def test_sensor_yaml_has_any_count_of_coefficients(tmp_path: Path, rough: Taken, count: int) -> None:
    root = write_euroc(tmp_path / "MH_01", rough)
    path = root / "mav0" / "cam0" / "sensor.yaml"
    line = next(line for line in path.read_text().splitlines() if "distortion_coefficients" in line)
    path.write_text(path.read_text().replace(line, f"distortion_coefficients: {[0.01] * count}"))
    assert read_sensor_yaml(path).model.coefficients == (0.01,) * count


def test_nothing_that_a_yaml_file_holds_can_run(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("a: !!python/object/apply:os.system ['true']\n")
    with pytest.raises(DataError, match="expected YAML"):
        read_yaml(path)
