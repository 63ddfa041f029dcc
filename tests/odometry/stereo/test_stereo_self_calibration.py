"""The calibration error of a pair, and its inverse."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from odometry.camera import StereoCamera
from odometry.stereo.stereo_self_calibration import NUM_COEFFICIENTS, Calibration, CalibrationConfig

KITTI = StereoCamera(718.856, 718.856, 607.19, 185.22, 0.54, 1241, 376)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_unrectify_undoes_rectify_for_far_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    config = CalibrationConfig()
    coefficients = rng.normal(size=NUM_COEFFICIENTS) * np.sqrt(np.diag(config.prior()))
    calibration = Calibration(KITTI, coefficients, config.prior())
    pixels = rng.uniform([0, 0], [KITTI.width, KITTI.height], (50, 2))
    left, right = calibration.rectify(*calibration.unrectify(pixels))
    np.testing.assert_allclose(left, pixels, atol=1e-6)
    np.testing.assert_allclose(right, pixels, atol=1e-6)
