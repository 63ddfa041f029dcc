"""Paths keep their length, their spacing and their distance to parallels."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slam.simulation.scenario.config import SimulationConfig
from slam.simulation.scenario.vehicle_path import STEP, Polyline, plan_full_path, plan_trajectory, resample


def ring(radius: float, count: int = 400) -> np.ndarray:
    angle = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


@settings(max_examples=60, deadline=None)
@given(
    points=st.lists(st.tuples(st.floats(-50, 50), st.floats(-50, 50)), min_size=2, max_size=12, unique=True),
    closed=st.booleans(),
)
def test_resampled_lines_keep_their_length_and_their_ends(points: list[tuple[float, float]], closed: bool) -> None:
    corners = np.array(points)
    around = np.vstack([corners, corners[:1]]) if closed else corners
    length = np.linalg.norm(np.diff(around, axis=0), axis=1).sum()
    if length < 1.0:
        return
    line = resample(corners, closed)
    assert line.length_m == pytest.approx(length, abs=STEP / 2 + 1e-9)
    np.testing.assert_allclose(line.points[0], corners[0], atol=1e-9)
    if not closed:
        np.testing.assert_allclose(line.points[-1], corners[-1], atol=1e-9)
    steps = np.linalg.norm(np.diff(line.points, axis=0), axis=1)
    assert steps.max() <= length / len(steps) + 1e-9  # straight parts have equal steps, corners are cut


@pytest.mark.parametrize("radius", [20.0, 60.0])
def test_the_heading_of_a_circle_turns_once(radius: float) -> None:
    line = resample(ring(radius), True)
    assert line.length_m == pytest.approx(2 * np.pi * radius, rel=1e-3)
    assert line.headings[-1] - line.headings[0] == pytest.approx(2 * np.pi, rel=0.01)


@pytest.mark.parametrize("left", [-3.0, 1.5])
def test_a_parallel_of_a_circle_is_a_circle(left: float) -> None:
    parallel = resample(ring(40.0), True).offset(left)
    np.testing.assert_allclose(np.linalg.norm(parallel.points, axis=1), 40.0 - left, atol=0.02)


@settings(max_examples=60, deadline=None)
@given(distance=st.floats(-500.0, 500.0), rounds=st.integers(-3, 3))
def test_a_closed_line_repeats_after_its_length(distance: float, rounds: int) -> None:
    line = resample(ring(30.0), True)
    there, _ = line.interpolate(np.array([distance]))
    again, _ = line.interpolate(np.array([distance + rounds * line.length_m]))
    np.testing.assert_allclose(there, again, atol=1e-6)


def test_an_open_line_ends_where_it_ends() -> None:
    line = resample(np.array([[0.0, 0.0], [10.0, 0.0]]), False)
    positions, headings = line.interpolate(np.array([-5.0, 0.0, 4.0, 10.0, 99.0]))
    np.testing.assert_allclose(positions[:, 0], [0.0, 0.0, 4.0, 10.0, 10.0])
    np.testing.assert_allclose(headings, 0.0)


@settings(max_examples=40, deadline=None)
@given(start=st.floats(0.0, 100.0), step=st.floats(0.05, 5.0))
def test_distance_along_the_line_is_distance_driven(start: float, step: float) -> None:
    line = resample(ring(60.0), True)
    positions, _ = line.interpolate(np.array([start, start + step]))
    chord = 2 * 60.0 * np.sin(step / (2 * 60.0))
    assert np.linalg.norm(positions[1] - positions[0]) == pytest.approx(chord, rel=2e-3, abs=1e-4)


def test_coinciding_points_are_resampled() -> None:
    line = resample(np.array([[0.0, 0.0], [0.0, 0.0], [4.0, 0.0], [4.0, 0.0]]), False)
    assert isinstance(line, Polyline)
    assert line.length_m == pytest.approx(4.0)


@pytest.mark.parametrize("reverse", [False, True])
def test_laps_follow_one_another_without_gaps(reverse: bool) -> None:
    config = SimulationConfig(shape="blocks", length_m=500, laps=3, reverse=reverse, lateral_offset_m=1.0)
    path, ends = plan_full_path(config)
    assert len(ends) == 3
    assert (np.diff(ends) > 0).all()
    assert path.length_m == pytest.approx(ends[-1], abs=2.0)
    assert np.linalg.norm(np.diff(path.points, axis=0), axis=1).max() < 1.05 * STEP


@pytest.mark.parametrize("laps", [1, 2, 3])
def test_every_lap_has_as_many_frames_as_its_length_asks_for(laps: int) -> None:
    trajectory = plan_trajectory(SimulationConfig(length_m=300, laps=laps, speed_m_per_s=10.0, frame_rate_hz=10.0))
    counts = np.bincount(trajectory.lap)
    assert len(counts) == laps
    np.testing.assert_allclose(counts, 300, atol=3)
    np.testing.assert_allclose(np.diff(trajectory.timestamps), 0.1)
    np.testing.assert_allclose(np.diff(trajectory.distance_m), 1.0)


def test_a_shorter_dataset_is_the_beginning_of_a_longer_one() -> None:
    long, short = (plan_trajectory(SimulationConfig(length_m=300, max_frames=n)) for n in (80, 30))
    np.testing.assert_allclose(short.T_town_camera, long.T_town_camera[:30])
