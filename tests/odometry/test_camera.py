"""Points go to pixels and come back."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from odometry import se3
from odometry.camera import StereoCamera, clamp_inverse_depth, triangulate

CAMERA = StereoCamera(fx=700.0, fy=710.0, cx=600.0, cy=180.0, baseline=0.54, width=1241, height=376)


@given(st.floats(-50, 50), st.floats(-10, 10), st.floats(0.5, 500))
def test_a_point_comes_back_from_its_pixels(x, y, z):
    u_left, u_right, v = CAMERA.project(np.array([[x, y, z]]))[0]
    back = CAMERA.triangulate(np.array([[u_left, v]]), np.array([u_left - u_right]))
    np.testing.assert_allclose(back, [[x, y, z]], rtol=1e-6, atol=1e-6)


def test_projection_is_multiplication_with_the_calibration_matrix():
    points = np.array([[1.0, 2.0, 10.0], [-3.0, 0.5, 40.0]])
    homogeneous = points @ CAMERA.K.T
    np.testing.assert_allclose(CAMERA.project(points)[:, [0, 2]], homogeneous[:, :2] / homogeneous[:, 2:])


def test_the_right_camera_stands_to_the_right():
    points = np.array([[1.0, 2.0, 10.0]])
    seen_from_there = CAMERA.project(points - [CAMERA.baseline, 0, 0])[:, 0]
    np.testing.assert_allclose(CAMERA.project(points)[:, 1], seen_from_there)


def test_points_behind_the_camera_and_disparities_below_zero_are_nan():
    assert np.isnan(CAMERA.project(np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0]]))).all()
    assert np.isnan(CAMERA.triangulate(np.zeros((2, 2)), np.array([0.0, -1.0]))).all()


@pytest.mark.parametrize("change", [{"fx": -1.0}, {"baseline": 0.0}, {"cy": np.nan}])
def test_intrinsics_that_no_camera_has_are_refused(change):
    good = {"fx": 1.0, "fy": 1.0, "cx": 0.0, "cy": 0.0, "baseline": 1.0, "width": 4, "height": 3}
    with pytest.raises(ValueError, match="positive focal lengths and baseline"):
        StereoCamera(**{**good, **change})


def two_views(points, T_second_first):
    """Rays (N, 3) with z = 1 of points (N, 3) in two cameras."""
    second = se3.transform(T_second_first, points)
    return points / points[:, 2:], second / second[:, 2:]


@given(st.integers(0, 10**6))
def test_two_views_give_the_inverse_depth(seed):
    rng = np.random.default_rng(seed)
    points = rng.uniform([-10, -5, 5], [10, 5, 60], (20, 3))
    T_second_first = se3.exp(np.concatenate([rng.normal(0, 0.05, 3), [1.0, 0.3, -0.5]]))
    inverse_depth, strength = triangulate(*two_views(points, T_second_first), T_second_first)
    np.testing.assert_allclose(inverse_depth, 1.0 / points[:, 2], rtol=1e-6)
    assert (strength > 0).all()


def test_each_point_may_have_its_own_second_camera():
    rng = np.random.default_rng(1)
    points = rng.uniform([-10, -5, 5], [10, 5, 60], (4, 3))
    motions = se3.exp(np.column_stack([rng.normal(0, 0.05, (4, 3)), np.tile([1.0, 0.3, -0.5], (4, 1))]))
    seen = np.concatenate([two_views(p[None], T)[1] for p, T in zip(points, motions, strict=True)])
    together = triangulate(points / points[:, 2:], seen, motions)
    for k in range(4):
        alone = triangulate(points[k : k + 1] / points[k, 2], seen[k : k + 1], motions[k])
        np.testing.assert_allclose([together[0][k], together[1][k]], [alone[0][0], alone[1][0]])


def test_a_camera_that_only_turns_has_no_parallax():
    rng = np.random.default_rng(2)
    turn = se3.exp(np.array([0.01, 0.05, -0.02, 0, 0, 0]))
    _, strength = triangulate(*two_views(rng.uniform([-10, -5, 5], [10, 5, 60], (20, 3)), turn), turn)
    np.testing.assert_allclose(strength, 0.0, atol=1e-20)


def test_the_strength_is_the_squared_shift_by_a_unit_of_inverse_depth():
    aside, ray, step = se3.pose(np.eye(3), np.array([0.8, -0.2, 0.0])), np.array([0.1, 0.05, 1.0]), 1e-6
    near, far = (ray + d * aside[:3, 3] for d in (0.1 + step, 0.1))
    shift = (near / near[2] - far / far[2])[:2] / step
    _, strength = triangulate(ray[None], (far / far[2])[None], aside)
    assert strength[0] == pytest.approx(shift @ shift, rel=1e-6)


def test_inverse_depths_stay_in_front_of_the_camera_and_finite():
    clamped = clamp_inverse_depth(np.array([-1.0, 0.0, 0.05, 100.0, np.inf]))
    assert clamped[2] == 0.05
    assert (clamped > 0).all()
    assert 1.0 / clamped.max() == pytest.approx(0.3)
