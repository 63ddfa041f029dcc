"""The height of the camera above a road whose plane is known, among things that are no road."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from odometry.mono.ground_plane_scale import (
    GroundPlaneConfig,
    GroundPlaneScale,
    NullScaleCorrection,
    estimate_camera_height,
)
from odometry.mono.mono_config import MonoOdometryConfig


def street(rng, height=1.65, pitch=0.0, noise=0.01):
    """Points (N, 3) of a road below a camera that looks a little up or down, of kerbs, cars and houses."""
    road = np.column_stack([rng.uniform(-4, 4, 60), np.full(60, height), rng.uniform(5, 20, 60)])
    other = np.column_stack([rng.uniform(-6, 6, 50), rng.uniform(-3, height - 0.15, 50), rng.uniform(5, 25, 50)])
    points = np.concatenate([road, other]) * (1 + noise * rng.normal(size=(110, 1)))
    points[:, 1] += np.tan(pitch) * points[:, 2]
    return points


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.3, 10.0), st.floats(-0.05, 0.05))
def test_the_height_is_found_in_any_unit(seed, unit, pitch):
    points = unit * street(np.random.default_rng(seed), pitch=pitch)
    assert estimate_camera_height(points, GroundPlaneConfig()) == pytest.approx(1.65 * unit, rel=0.04)


def test_there_is_no_height_without_a_road():
    rng = np.random.default_rng(0)
    cloud = rng.uniform([-10, -5, 3], [10, 5, 40], (100, 3))
    assert estimate_camera_height(cloud, GroundPlaneConfig()) is None
    assert estimate_camera_height(np.zeros((0, 3)), GroundPlaneConfig()) is None


def test_the_ruler_settles_on_the_scale_that_most_roads_tell():
    rng, ruler, scale = np.random.default_rng(1), GroundPlaneScale(1.65, GroundPlaneConfig()), 0.4
    for k in range(60):
        height = 1.65 * (1.6 if k % 10 == 9 else 1.0)  # now and then a ramp
        scale *= ruler.update(scale * street(rng, height))
    assert scale == pytest.approx(1.0, rel=0.05)


def test_the_first_road_sets_the_scale_at_once():
    ruler = GroundPlaneScale(1.65, GroundPlaneConfig())
    points = 0.4 * street(np.random.default_rng(2))
    assert 0.4 * ruler.update(points) == pytest.approx(1.0, rel=0.1)


def test_without_a_height_nothing_is_resized():
    assert NullScaleCorrection().update(street(np.random.default_rng(3))) == 1.0


@pytest.mark.parametrize("height", [-1.0, float("nan"), float("inf")])
def test_a_height_that_is_none_is_refused(height):
    with pytest.raises(ValueError, match="height_m: expected metres above the road"):
        MonoOdometryConfig(camera_height_m=height)
