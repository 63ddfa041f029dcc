"""Rotation alone: exact from exact rays, honest about what it cannot see, and no explanation of a translation."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from odometry import se3
from odometry.camera import StereoCamera
from odometry.distortion import LensDistortion, LensDistortionConfig
from odometry.mono.rotation_estimation import estimate_rotation, explains_as_well

CAMERA = StereoCamera(fx=350.0, fy=350.0, cx=255.5, cy=111.5, baseline=0.5, width=512, height=224)
LENS = LensDistortion.unknown(CAMERA, LensDistortionConfig())
TURN = np.array([0.02, -0.06, 0.03, 0.0, 0.0, 0.0])


def views(rng, T_first_second, noise_px=0.0, depths=(5.0, 40.0), count=150):
    """Pixels of the same points in two images."""
    first = rng.uniform([60, 30], [450, 190], (count, 2))
    points = LENS.rays(first) * rng.uniform(*depths, (count, 1))
    second = LENS.pixels(se3.transform(se3.inverse(T_first_second), points))
    return first, second + rng.normal(0, noise_px, second.shape)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6))
def test_exact_rays_give_the_exact_rotation_whatever_their_depths(seed):
    rng = np.random.default_rng(seed)
    truth = se3.exp(np.concatenate([rng.uniform(-0.1, 0.1, 3), np.zeros(3)]))
    found = estimate_rotation(LENS, *views(rng, truth), 15.0)
    np.testing.assert_allclose(found.T_first_second, truth, atol=1e-9)
    assert found.inliers.all()


def test_tracks_of_something_that_moves_are_left_out():
    rng = np.random.default_rng(1)
    first, second = views(rng, se3.exp(TURN), 0.1)
    second[:60] += [6.0, 2.0]
    found = estimate_rotation(LENS, first, second, 15.0)
    assert not found.inliers[:60].any()
    assert se3.angle(se3.inverse(se3.exp(TURN)) @ found.T_first_second) < 5e-4


@pytest.mark.parametrize("noise_px", [0.1, 0.4])
def test_a_translation_that_noise_hides_lies_within_the_covariance(noise_px):
    """Half the parallax that the noise would show at the median depth: it is there, and nobody can see it."""
    shift = 0.5 * noise_px / CAMERA.fx * 15.0
    T = se3.exp(TURN) @ se3.pose(np.eye(3), np.array([shift, 0.0, 0.0]))
    found = estimate_rotation(LENS, *views(np.random.default_rng(2), T, noise_px), 15.0)
    deviation = np.sqrt(np.diag(found.covariance))
    off = np.abs(se3.log(se3.inverse(found.T_first_second) @ T))
    assert (off < 3 * deviation).all()
    assert deviation[3:].max() < 3 * noise_px / CAMERA.fx * 15.0


@pytest.mark.parametrize(("shift", "expected"), [(0.0, True), (0.3, False)])
def test_a_rotation_explains_a_turn_and_not_a_step_aside(shift, expected):
    rng = np.random.default_rng(3)
    first, second = views(rng, se3.pose(se3.exp(TURN)[:3, :3], np.array([shift, 0.0, 0.0])), 0.2)
    rotation = estimate_rotation(LENS, first, second, 15.0)
    # A motion that knows the truth has errors of the noise alone.
    motion = estimate_rotation(LENS, *views(np.random.default_rng(4), se3.exp(TURN), 0.2), 15.0)
    assert explains_as_well(rotation, motion, 0.2, 0) is expected
