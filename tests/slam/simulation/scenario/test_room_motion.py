import numpy as np
import open3d
import pytest

from slam.simulation import RoomConfig
from slam.simulation.room_simulator import plan_motion
from slam.simulation.scenario.free_space import find_free_space
from slam.simulation.world.room import build_room

SEEDS = (1, 2, 3)


def plan(**settings):
    config = RoomConfig(**settings)
    room = build_room(config.seed)
    return room, plan_motion(config, room).T_room_camera


def rates_deg_per_s(poses, rate=30.0):
    R = poses[:, :3, :3]
    trace = np.einsum("nij,nij->n", R[:-1], R[1:])
    return np.degrees(np.arccos(np.clip((trace - 1) / 2, -1, 1))) * rate


def speeds(poses, rate=30.0):
    return np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1) * rate


def distances_to_surfaces(room, points, min_height=0.05):
    """Distance to the nearest triangle that reaches above a height: the floor is no obstacle of a robot."""
    corners = np.concatenate([mesh.corners for mesh in room.meshes])
    corners = corners[corners[:, :, 2].max(axis=1) > min_height].reshape(-1, 3).astype(np.float32)
    scene = open3d.t.geometry.RaycastingScene()
    numbers = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
    scene.add_triangles(open3d.core.Tensor(corners), open3d.core.Tensor(numbers))
    return scene.compute_distance(open3d.core.Tensor(points.astype(np.float32))).numpy()


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("motion", ["hand", "robot"])
def test_the_camera_keeps_its_distance_from_everything(seed: int, motion: str):
    room, poses = plan(seed=seed, motion=motion)
    assert distances_to_surfaces(room, poses[::3, :3, 3]).min() > 0.39


@pytest.mark.parametrize("seed", SEEDS)
def test_a_carried_camera_is_lively_but_smooth(seed: int):
    _, poses = plan(seed=seed)
    speed, rate = speeds(poses), rates_deg_per_s(poses)
    assert 0.3 < np.median(speed) < 0.8
    assert speed.max() < 1.0
    assert rate.max() < 65.0
    assert np.percentile(rate, 95) > 35.0
    assert np.abs(np.diff(speed)).max() * 30 < 3.0  # m/s^2
    assert np.abs(np.diff(rate)).max() * 30 < 400.0  # deg/s^2
    assert 1.0 < poses[:, 2, 3].min() < poses[:, 2, 3].max() < 1.9


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("motion", ["hand", "robot"])
def test_the_camera_visits_the_corridor_and_returns_to_earlier_views(seed: int, motion: str):
    room, poses = plan(seed=seed, motion=motion, duration_s=90.0)
    outside = poses[:, 1, 3] > room.corridor[1]
    assert 0.05 < outside.mean() < 0.6
    assert (~outside[np.argmax(outside) :]).any()
    at, forward = poses[::15, :3, 3], poses[::15, :3, 2]
    near = np.linalg.norm(at[:, None] - at[None], axis=2) < 0.5
    alike = forward @ forward.T > np.cos(np.radians(30))
    later = np.arange(len(at))[:, None] - np.arange(len(at))[None] > 20  # 10 s
    assert (near & alike & later).any(axis=1).mean() > 0.15


def test_a_robot_drives_straight_and_turns_on_the_spot():
    _, poses = plan(seed=1, motion="robot")
    speed, rate = speeds(poses), rates_deg_per_s(poses)
    driving, turning = speed > 0.2, rate > 20.0
    assert not (driving & turning).any()
    assert driving.mean() > 0.2
    assert turning.mean() > 0.2
    assert speed.max() < 0.62
    assert rate.max() < 60.0
    np.testing.assert_allclose(poses[:, 2, 3], 0.4, atol=0.005)
    np.testing.assert_allclose(np.degrees(np.arcsin(poses[:, 2, 2])), 8.0, atol=0.5)
    yaw = np.unwrap(np.arctan2(poses[:, 1, 2], poses[:, 0, 2]))
    heading = np.diff(poses[:, :2, 3], axis=0)[driving]
    forward = np.stack([np.cos(yaw), np.sin(yaw)], axis=1)[:-1][driving]
    assert ((heading * forward).sum(axis=1) > 0.999 * np.linalg.norm(heading, axis=1)).all()


def test_pure_rotation_turns_without_moving():
    _, poses = plan(seed=1, pure_rotation_s=10.0, duration_s=40.0)
    still = speeds(poses) == 0.0
    assert still.sum() == pytest.approx(300, abs=2)
    first = int(np.argmax(still))
    assert still[first : first + 298].all()
    assert (15.0 - first / 30.0) == pytest.approx(0.0, abs=0.1)
    turning = poses[first : first + 299]
    assert np.ptp(turning[:, :3, 3], axis=0).max() == 0.0
    yaw = np.unwrap(np.arctan2(turning[:, 1, 2], turning[:, 0, 2]))
    assert abs(yaw[-1] - yaw[0]) > np.radians(300)
    assert rates_deg_per_s(turning).max() < 65.0


def test_the_same_motion_at_another_frame_rate():
    _, slow = plan(seed=1, duration_s=10.0, frame_rate_hz=10.0)
    _, fast = plan(seed=1, duration_s=10.0, frame_rate_hz=30.0)
    np.testing.assert_allclose(fast[::3], slow, atol=1e-9)


def test_poses_are_rigid_and_the_image_is_upright():
    for motion in ("hand", "robot"):
        _, poses = plan(seed=2, motion=motion, duration_s=20.0)
        R = poses[:, :3, :3]
        np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.tile(np.eye(3), (len(R), 1, 1)), atol=1e-12)
        np.testing.assert_allclose(np.linalg.det(R), 1.0)
        assert (R[:, 2, 1] < -0.8).all()  # y of the camera points down


def test_another_seed_moves_otherwise():
    _, a = plan(seed=1)
    _, b = plan(seed=2)
    assert np.abs(a - b).max() > 0.5


def test_clearance_is_the_distance_to_walls_and_furniture():
    floors = np.array([[0.0, 0.0, 4.0, 3.0]])
    table = np.array([[[3.0, 1.0, 0.0], [4.0, 2.0, 0.7]]])
    lamp = np.array([[[1.0, 1.0, 2.4], [1.5, 2.0, 2.6]]])
    space = find_free_space(floors, np.concatenate([table, lamp]), 0.1, 2.2)
    points = np.array([[1.0, 1.5], [2.5, 1.5], [0.3, 0.5]])
    np.testing.assert_allclose(space.clearance_at(points), [1.0, 0.5, 0.3], atol=0.08)


def test_a_route_goes_round_a_shelf():
    floors = np.array([[0.0, 0.0, 6.0, 5.0]])
    shelf = np.array([[[2.8, 0.0, 0.0], [3.2, 3.5, 2.0]]])
    space = find_free_space(floors, shelf, 0.1, 2.0)
    legs = space.route(np.array([[1.0, 1.0], [5.0, 1.0]]), 0.5)
    path = np.vstack(legs)
    assert space.clearance_at(path).min() >= 0.5 - 1e-9
    assert path[:, 1].max() > 3.9
    smooth = space.smooth(path, 0.5)
    assert space.clearance_at(smooth).min() >= 0.48
    assert not space.sees(np.array([1.0, 1.0]), np.array([1.0, 7.0]))
    assert space.sees(np.array([1.0, 1.0]), np.array([5.0, 1.0]))
