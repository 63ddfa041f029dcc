"""Points go to pixels and come back."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from odometry.camera import StereoCamera

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
