"""COLMAP reads what is exported, and finds the same cameras, images and points."""

from pathlib import Path

import numpy as np
import pytest

from odometry import se3
from odometry.camera import StereoCamera
from slam.cli import app
from slam.errors import DataError
from slam.io.landmarks import read_landmark_observers, write_cloud, write_landmark_observers
from slam.io.trajectory_files import write_tum
from slam.mapping.landmark_map import LandmarkMap

CAMERA = StereoCamera(200.0, 210.0, 80.5, 60.25, 0.5, 160, 120)
SEEN = ((0, 3), (1, 0), (3, 2))  # frame, landmarks


@pytest.fixture
def poses() -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.stack([se3.exp(rng.normal(scale=0.3, size=6)) for _ in range(4)])


@pytest.fixture
def landmarks() -> LandmarkMap:
    rng, kept = np.random.default_rng(1), LandmarkMap()
    for frame, count in SEEN:
        points = rng.uniform([-2, -2, 4], [2, 2, 20], (count, 3))
        kept.add(frame, points, rng.integers(0, 256, count).astype(np.uint8))
    return kept


@pytest.fixture
def run(tmp_path: Path, poses: np.ndarray, landmarks: LandmarkMap) -> Path:
    folder = tmp_path / "run"
    folder.mkdir()
    write_tum(folder / "trajectory_corrected.tum", np.arange(4.0), poses)
    write_cloud(folder / "map_after.ply", landmarks.cloud(poses))
    write_landmark_observers(folder / "landmarks.npz", landmarks.frames, CAMERA)
    return folder


def export(run: Path, *more: str) -> int:
    return app._exit_code(lambda: app.app(["export", str(run), "--format", "colmap", *more]))


def test_colmap_itself_reads_the_same_model(run: Path, poses: np.ndarray, landmarks: LandmarkMap) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    assert export(run) == 0
    model = pycolmap.Reconstruction()
    model.read_text(run.with_name("run_corrected_colmap"))
    (camera,) = model.cameras.values()
    assert (camera.model.name, camera.width, camera.height) == ("PINHOLE", 160, 120)
    np.testing.assert_allclose(camera.params, [200.0, 210.0, 81.0, 60.75])
    assert sorted(image.name for image in model.images.values()) == [f"{k:06d}.png" for k in range(4)]
    cloud = landmarks.cloud(poses)
    for index, image in model.images.items():
        pose = image.cam_from_world() if callable(image.cam_from_world) else image.cam_from_world
        T_camera_world = np.vstack([pose.matrix(), [0, 0, 0, 1]])
        np.testing.assert_allclose(T_camera_world @ poses[index - 1], np.eye(4), atol=1e-9)
        assert [p.point3D_id - 1 for p in image.points2D] == np.flatnonzero(landmarks.frames == index - 1).tolist()
        for seen in image.points2D:  # where COLMAP itself projects the landmark to
            np.testing.assert_allclose(image.project_point(cloud.points[seen.point3D_id - 1]), seen.xy, atol=1e-6)
    for index, point in model.points3D.items():
        np.testing.assert_allclose(point.xyz, cloud.points[index - 1], atol=1e-9)
        assert point.color.tolist() == [cloud.grey[index - 1]] * 3
        assert [element.image_id for element in point.track.elements] == [landmarks.frames[index - 1] + 1]


def words(path: Path) -> list[list[str]]:
    return [line.split() for line in path.read_text().splitlines() if not line.startswith("#")]


def test_the_files_say_what_the_format_asks_for(run: Path, poses: np.ndarray, landmarks: LandmarkMap) -> None:
    assert export(run, "--out", str(run / "model")) == 0
    folder = run / "model"
    assert sorted(item.name for item in folder.iterdir()) == ["cameras.txt", "images.txt", "points3D.txt"]
    assert words(folder / "cameras.txt") == [["1", "PINHOLE", "160", "120", "200.0", "210.0", "81.0", "60.75"]]
    images, points = words(folder / "images.txt"), words(folder / "points3D.txt")
    assert [len(line) for line in images] == [10, 9, 10, 0, 10, 0, 10, 6]
    for frame, line in enumerate(images[::2]):
        w, *xyz = np.array(line[1:5], float)
        t = np.array(line[5:8], float)
        R = quaternion_matrix(w, np.array(xyz))
        np.testing.assert_allclose(R @ poses[frame, :3, :3], np.eye(3), atol=1e-9)
        np.testing.assert_allclose(-R.T @ t, poses[frame, :3, 3], atol=1e-9)
    assert [(line[8], line[9]) for line in points] == [("1", "0"), ("1", "1"), ("1", "2"), ("4", "0"), ("4", "1")]
    np.testing.assert_allclose(np.array([line[1:4] for line in points], float), landmarks.cloud(poses).points)


def quaternion_matrix(w: float, v: np.ndarray) -> np.ndarray:
    """Rodrigues' formula."""
    cross = np.cross(np.eye(3), v)
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross


def test_an_existing_model_stays_without_overwrite(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert export(run) == 0
    assert export(run) == 1
    assert "--overwrite" in capsys.readouterr().err
    assert export(run, "--overwrite") == 0


def test_landmarks_of_another_run_are_refused(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_landmark_observers(run / "landmarks.npz", np.array([0, 9], np.int32), CAMERA)
    assert export(run) == 1
    assert "landmarks.npz: expected a frame, up to 3, for each of 5 landmarks, found 2" in capsys.readouterr().err
    assert not run.with_name("run_corrected_colmap").exists()


def test_sightings_come_back_and_others_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "landmarks.npz"
    write_landmark_observers(path, np.array([0, 0, 5], np.int32), CAMERA)
    read = read_landmark_observers(path)
    assert (read.frames.tolist(), read.intrinsics.tolist()) == ([0, 0, 5], [200.0, 210.0, 80.5, 60.25])
    np.savez(path, frames=np.array([-1], np.int32), intrinsics=read.intrinsics, size=read.size)
    with pytest.raises(DataError, match=r"landmarks\.npz: expected a camera, and frames from 0 on"):
        read_landmark_observers(path)
