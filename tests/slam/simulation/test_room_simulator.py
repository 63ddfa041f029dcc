import json

import cv2
import numpy as np
import open3d
import pykitti
import pytest

from odometry import se3
from slam.datasets.dataset import DatasetSpec
from slam.datasets.formats.tum_rgbd import open_tum_rgbd
from slam.errors import OutputError
from slam.simulation import RoomConfig, room_simulator, simulate_room
from slam.simulation.rendering.depth_camera import DEPTH_SCALE

SMALL = RoomConfig(seed=1, width=160, height=120, frame_rate_hz=4.0, max_frames=6, difficulty="clean")


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    return simulate_room(SMALL, tmp_path_factory.mktemp("rooms") / "a")


def files(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def read_list(folder, name):
    lines = (folder / f"{name}.txt").read_text().splitlines()
    return [line.split() for line in lines if not line.startswith("#")]


def read_poses(folder):
    rows = np.loadtxt(folder / "groundtruth.txt")
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    x, y, z, w = rows[:, 4:].T
    poses[:, :3, 0] = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)], 1)
    poses[:, :3, 1] = np.stack([2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)], 1)
    poses[:, :3, 2] = np.stack([2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)], 1)
    poses[:, :3, 3] = rows[:, 1:4]
    return poses


def read_frames(folder):
    """Grey images, depths in metres and poses of a room."""
    images = [cv2.imread(str(folder / name), cv2.IMREAD_UNCHANGED) for _, name in read_list(folder, "rgb")]
    depths = [cv2.imread(str(folder / name), cv2.IMREAD_UNCHANGED) for _, name in read_list(folder, "depth")]
    return images, [depth / DEPTH_SCALE for depth in depths], read_poses(folder)


def back_project(depth, camera, T):
    """World points (N, 3) of the pixels with depth, and those pixels (N, 2)."""
    v, u = np.nonzero(depth)
    z = depth[v, u]
    points = np.stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z], axis=1)
    return se3.transform(T, points), np.stack([u, v], axis=1)


def distance_to_surfaces(path, points):
    mesh = open3d.t.io.read_triangle_mesh(str(path))
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(mesh)
    return scene.compute_distance(open3d.core.Tensor(points.astype(np.float32))).numpy()


def test_a_pixel_with_its_depth_and_the_true_pose_lies_on_the_surfaces(room):
    _, depths, poses = read_frames(room)
    for depth, T in zip(depths, poses, strict=True):
        points, _ = back_project(depth, SMALL.camera, T)
        distance = distance_to_surfaces(room / "surfaces.ply", points)
        assert np.median(distance) < 0.0005
        assert np.percentile(distance, 90) < 0.005


def test_a_wrong_pose_is_noticed(room):
    _, depths, poses = read_frames(room)
    points, _ = back_project(depths[0], SMALL.camera, poses[0] @ se3.pose(np.eye(3), np.array([0.0, 0.0, 0.02])))
    assert np.median(distance_to_surfaces(room / "surfaces.ply", points)) > 0.005


def warp_errors(folder, shift_m=0.0):
    """Differences of grey value between frame 0 and frame 1, which has been warped by depth and true poses."""
    images, depths, poses = read_frames(folder)
    camera = SMALL.camera
    points, pixels = back_project(depths[0], camera, poses[0])
    seen = se3.transform(se3.inverse(poses[1]), points) + np.array([shift_m, 0.0, 0.0])
    z = seen[:, 2]
    u, v = camera.fx * seen[:, 0] / z + camera.cx, camera.fy * seen[:, 1] / z + camera.cy
    inside = (z > 0.3) & (u > 1) & (v > 1) & (u < camera.width - 2) & (v < camera.height - 2)
    u, v = u[inside].astype(np.float32)[None], v[inside].astype(np.float32)[None]
    there = cv2.remap(images[1].astype(np.float32), u, v, cv2.INTER_LINEAR)[0]
    near = cv2.remap(depths[1].astype(np.float32), u, v, cv2.INTER_NEAREST)[0]
    visible = np.abs(near - z[inside]) < 0.02
    here = images[0][pixels[inside, 1], pixels[inside, 0]].astype(np.float64)
    return np.abs(there - here)[visible]


def test_two_images_agree_when_warped_by_depth_and_the_true_poses(room):
    right, wrong = warp_errors(room), warp_errors(room, shift_m=0.05)
    assert len(right) > 5000
    assert np.median(right) < 1.5
    assert right.mean() < 0.6 * wrong.mean()


def test_the_layout_is_that_of_the_benchmark_and_is_read_as_one_camera(room):
    assert {p.name for p in room.iterdir()} == {
        "rgb", "depth", "rgb.txt", "depth.txt", "groundtruth.txt", "camera.toml", "surfaces.ply", "drive.json",
    }  # fmt: skip
    data = open_tum_rgbd(DatasetSpec(room))
    assert len(data) == 6
    assert data.ground_truth is not None
    poses = read_poses(room)
    np.testing.assert_allclose(data.ground_truth, se3.inverse(poses[0]) @ poses, atol=1e-6)
    for time, name in read_list(room, "rgb") + read_list(room, "depth"):
        assert name.endswith(f"/{time}.png")
        assert (room / name).is_file()


def test_the_manifest_has_the_whole_configuration(room):
    assert RoomConfig(**json.loads((room / "drive.json").read_text())["config"]) == SMALL


def test_equal_configurations_give_equal_bits_for_any_number_of_threads(room, tmp_path, monkeypatch):
    monkeypatch.setattr(room_simulator, "_WORKERS", 1)
    room_simulator.light_room.cache_clear()
    assert files(room) == files(simulate_room(SMALL, tmp_path / "b"))


def test_a_noisy_sensor_gives_equal_bits_too(tmp_path, monkeypatch):
    config = RoomConfig(**{**SMALL.__dict__, "difficulty": "standard", "max_frames": 3})
    first = files(simulate_room(config, tmp_path / "a"))
    monkeypatch.setattr(room_simulator, "_WORKERS", 3)
    assert first == files(simulate_room(config, tmp_path / "b"))
    clean = files(simulate_room(RoomConfig(**{**config.__dict__, "difficulty": "clean"}), tmp_path / "c"))
    assert first["rgb/0.000000.png"] != clean["rgb/0.000000.png"]
    assert first["depth/0.000000.png"] != clean["depth/0.000000.png"]


def test_measured_depth_differs_from_the_truth_as_a_depth_camera_does(tmp_path):
    settings = {**SMALL.__dict__, "max_frames": 3, "lens_error_px": 0.0, "rectification_error_px": 0.0}
    truth = simulate_room(RoomConfig(**settings), tmp_path / "a")
    noisy = simulate_room(RoomConfig(**{**settings, "difficulty": "standard"}), tmp_path / "b")
    for true, measured in zip(read_frames(truth)[1], read_frames(noisy)[1], strict=True):
        seen = measured > 0
        assert 0.4 < seen.mean() < 0.97
        error = (measured - true)[seen] / true[seen] ** 2
        # Of 1.5 mm at one metre and steps of 3.2 mm there, median absolute value and standard deviation.
        assert 1.4826 * np.median(np.abs(error - np.median(error))) == pytest.approx(0.00176, rel=0.15)
        assert measured[seen].max() < 5.05


def test_one_camera_has_no_depth(tmp_path):
    folder = simulate_room(RoomConfig(**{**SMALL.__dict__, "sensor": "mono", "max_frames": 2}), tmp_path / "a")
    assert not (folder / "depth").exists()
    assert not (folder / "depth.txt").exists()
    assert len(read_list(folder, "rgb")) == 2


def test_a_pair_has_the_layout_of_kitti_with_surfaces_in_the_frame_of_its_poses(room, tmp_path):
    folder = simulate_room(RoomConfig(**{**SMALL.__dict__, "sensor": "stereo"}), tmp_path / "a")
    data = pykitti.odometry(str(folder), "00")
    assert len(data.poses) == len(data.timestamps) == 6
    assert data.calib.b_gray == pytest.approx(0.11)
    np.testing.assert_allclose(data.poses[0], np.eye(4), atol=1e-9)
    images, depths, poses = read_frames(room)
    np.testing.assert_array_equal(np.array(data.get_gray(2)[0]), images[2])  # the left camera is the same
    np.testing.assert_allclose(np.array(data.poses), se3.inverse(poses[0]) @ poses, atol=1e-5)
    points, pixels = back_project(depths[0], SMALL.camera, np.eye(4))
    assert np.median(distance_to_surfaces(folder / "surfaces.ply", points)) < 0.0005
    # A pixel and its partner in the right image are alike: disparity is f b / z.
    right = np.array(data.get_gray(0)[1]).astype(np.float32)
    u = (pixels[:, 0] - SMALL.camera.fx * 0.11 / points[:, 2]).astype(np.float32)[None]
    partner = cv2.remap(right, u, pixels[:, 1].astype(np.float32)[None], cv2.INTER_LINEAR)[0]
    left = images[0][pixels[:, 1], pixels[:, 0]]
    assert np.median(np.abs(partner - left)[u[0] > 0]) < 1.5


def test_an_existing_room_is_not_rendered_again(room):
    before = {p: p.stat().st_mtime_ns for p in room.rglob("*")}
    calls = []
    assert simulate_room(SMALL, room, lambda done, total: calls.append(done)) == room
    assert calls == []
    assert {p: p.stat().st_mtime_ns for p in room.rglob("*")} == before


def test_a_folder_with_another_room_is_refused_and_left_alone(room):
    before = files(room)
    with pytest.raises(OutputError, match="found something else; remove it or name another folder"):
        simulate_room(RoomConfig(**{**SMALL.__dict__, "seed": 2}), room)
    assert files(room) == before


def test_an_interrupted_simulation_leaves_nothing_behind(tmp_path):
    def stop(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate_room(SMALL, tmp_path / "d", stop)
    assert list(tmp_path.iterdir()) == []


def test_progress_counts_to_the_end(tmp_path):
    calls = []
    config = RoomConfig(**{**SMALL.__dict__, "width": 64, "height": 48, "max_frames": 3})
    simulate_room(config, tmp_path / "e", lambda done, total: calls.append((done, total)))
    assert calls == [(1, 3), (2, 3), (3, 3)]


def test_images_have_light_and_texture(room):
    images, depths, _ = read_frames(room)
    for image, depth in zip(images, depths, strict=True):
        assert image.dtype == np.uint8
        assert image.mean() == pytest.approx(125, abs=65)
        assert image.std() > 15
        assert (image == 255).mean() < 0.2
        assert depth[depth > 0].min() > 0.3
