from dataclasses import replace

import numpy as np
import pytest

from odometry import se3
from slam.errors import DataError
from slam.simulation.scenario.config import DIFFICULTIES, SimulationConfig
from slam.simulation.scenario.vehicle_path import LANE, plan_base_path, plan_full_path, plan_trajectory

SHAPES = ("circle", "figure-eight", "blocks")


def plan(trajectory):
    return trajectory.T_town_camera[:, :2, 3]


@pytest.mark.parametrize("shape", SHAPES)
def test_frames_are_as_far_apart_as_speed_and_frame_rate_require(shape):
    config = SimulationConfig(shape=shape, length_m=600, speed_m_per_s=12, frame_rate_hz=8, laps=1)
    trajectory = plan_trajectory(replace(config, difficulty="standard"))
    steps = np.linalg.norm(np.diff(plan(trajectory), axis=0), axis=1)
    assert np.median(steps) == pytest.approx(1.5, rel=5e-3)
    assert steps.max() < 1.51


def turns_deg(trajectory):
    poses = trajectory.T_town_camera
    return np.degrees([se3.angle(step) for step in se3.inverse(poses[:-1]) @ poses[1:]])


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("offset", [0.0, 1.5])
def test_corners_are_driven_as_cars_drive_them(shape, reverse, offset):
    # Cars turn by at most 4.8 degrees in a frame of KITTI 00, which has ten frames a second.
    config = SimulationConfig(shape=shape, length_m=400, laps=3, reverse=reverse, lateral_offset_m=offset)
    assert turns_deg(plan_trajectory(config)).max() < 4.8


def test_a_standard_drive_takes_corners_at_full_speed():
    trajectory = plan_trajectory(SimulationConfig(shape="blocks", length_m=400, laps=1, difficulty="standard"))
    assert turns_deg(trajectory).max() > 6.0


@pytest.mark.parametrize("shape", ["blocks", "figure-eight"])
def test_the_accelerations_of_a_car_are_bounded(shape):
    config = SimulationConfig(shape=shape, length_m=600, laps=1)
    trajectory, limits = plan_trajectory(config), config.conditions
    speeds = np.diff(trajectory.distance_m) * config.frame_rate_hz
    accelerations = np.diff(speeds) * config.frame_rate_hz
    assert accelerations.min() == pytest.approx(-limits.max_braking_m_per_s2, rel=0.1)
    assert accelerations.max() == pytest.approx(limits.max_speeding_m_per_s2, rel=0.1)
    assert speeds.max() == pytest.approx(config.speed_m_per_s)
    _, headings = trajectory.path.interpolate(trajectory.distance_m)
    lateral = np.abs(np.diff(headings)) * config.frame_rate_hz * speeds
    assert lateral.max() == pytest.approx(limits.max_lateral_m_per_s2, rel=0.1)


@pytest.mark.parametrize("difficulty", DIFFICULTIES)
def test_the_car_is_where_its_schedule_says(difficulty):
    config = SimulationConfig(shape="blocks", length_m=500, laps=1, difficulty=difficulty)
    trajectory = plan_trajectory(config)
    before_end = slice(None, -1)  # the last frame may be due a moment after the car has arrived
    np.testing.assert_allclose(
        trajectory.time_at(trajectory.distance_m[before_end]), trajectory.timestamps[before_end], atol=1e-9
    )
    beyond = trajectory.time_at(trajectory.path.length_m + np.array([0.0, 4.0, 8.0]))
    np.testing.assert_allclose(np.diff(beyond), 4.0 / config.speed_m_per_s, rtol=0.02)


@pytest.mark.parametrize("shape", SHAPES)
def test_a_lap_is_as_long_as_asked_and_closes(shape):
    path = plan_base_path(SimulationConfig(shape=shape, length_m=500))
    assert path.closed
    assert path.length_m == pytest.approx(500, rel=3e-3)
    assert np.linalg.norm(path.points[0] - path.points[-1]) < 0.3


def test_the_circle_is_round():
    points = plan_base_path(SimulationConfig(length_m=400)).points
    radius = np.linalg.norm(points - points.mean(axis=0), axis=1)
    np.testing.assert_allclose(radius, 400 / (2 * np.pi), rtol=1e-3)


@pytest.mark.parametrize("shape", SHAPES)
def test_headings_follow_the_path_without_jumps(shape):
    config = SimulationConfig(shape=shape, length_m=600, reverse=True, laps=3, lateral_offset_m=0.7)
    turns = np.abs(np.diff(plan_full_path(config)[0].headings))
    assert turns.max() < np.radians(6)  # over a quarter of a metre, in the tightest turn


def test_a_second_lap_passes_the_same_places():
    trajectory = plan_trajectory(SimulationConfig(length_m=360, laps=2))
    first, second = plan(trajectory)[:360], plan(trajectory)[360:720]
    assert np.linalg.norm(first - second[: len(first)], axis=1).max() < 0.3


def test_a_later_lap_is_offset_to_the_right():
    path, ends = plan_full_path(SimulationConfig(length_m=360, laps=2, lateral_offset_m=1.2))
    base = plan_base_path(SimulationConfig(length_m=360))
    there, heading = path.interpolate(np.array([ends[0] + 180.0]))
    right = np.array([np.sin(heading[0]), -np.cos(heading[0])])
    nearest = base.points[np.linalg.norm(base.points - there[0], axis=1).argmin()]
    assert (there[0] - nearest) @ right == pytest.approx(1.2, abs=0.05)


def test_the_opposite_direction_is_driven_in_the_other_lane():
    trajectory = plan_trajectory(SimulationConfig(length_m=360, laps=2, reverse=True))
    forward = trajectory.T_town_camera[:, :3, 2]
    late = np.flatnonzero(trajectory.lap == 1)[120]
    gaps = np.linalg.norm(plan(trajectory)[trajectory.lap == 0] - plan(trajectory)[late], axis=1)
    assert gaps.min() == pytest.approx(2 * LANE, abs=0.1)
    assert forward[gaps.argmin()] @ forward[late] < -0.99


def test_poses_are_rigid_and_look_along_the_path():
    trajectory = plan_trajectory(SimulationConfig(max_frames=50))
    R = trajectory.T_town_camera[:, :3, :3]
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.tile(np.eye(3), (50, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(R), 1.0)
    ahead = np.diff(trajectory.T_town_camera[:, :3, 3], axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    assert (np.einsum("ni,ni->n", ahead, trajectory.T_town_camera[:-1, :3, 2]) > 0.99).all()
    assert (trajectory.T_town_camera[:, 2, 1] < -0.99).all()  # the camera's y points down


def test_the_camera_sways_but_little_between_frames():
    trajectory = plan_trajectory(SimulationConfig(max_frames=200))
    steps = se3.inverse(trajectory.T_town_camera[:-1]) @ trajectory.T_town_camera[1:]
    turn = np.array([se3.log(T)[:3] for T in steps])
    assert 1e-4 < turn[:, 0].std() < np.radians(1)
    assert 1e-4 < turn[:, 2].std() < np.radians(1)


def test_a_pose_file_is_driven_along_its_plan(tmp_path):
    z = np.arange(0.0, 200.0, 0.8)
    rows = np.tile(np.eye(4)[:3], (len(z), 1, 1))
    rows[:, 0, 3], rows[:, 2, 3] = 10 * np.sin(z / 40), z
    np.savetxt(tmp_path / "poses.txt", rows.reshape(-1, 12))
    trajectory = plan_trajectory(SimulationConfig(shape=str(tmp_path / "poses.txt")))
    x, y = plan(trajectory).T
    np.testing.assert_allclose(x, 10 * np.sin(y / 40), atol=0.05)


def test_a_file_that_is_no_pose_file_is_named(tmp_path):
    (tmp_path / "notes.txt").write_text("1 2 3\n")
    with pytest.raises(DataError, match=r"notes.txt, line 1: expected 12 finite numbers, found 3"):
        plan_trajectory(SimulationConfig(shape=str(tmp_path / "notes.txt")))
