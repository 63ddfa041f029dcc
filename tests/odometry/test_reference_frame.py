"""A reference frame keeps the motion since, its covariance and its age."""

import numpy as np
import pytest

from odometry import se3
from odometry.motion import extrapolation_covariance
from odometry.reference_frame import Reference

STEP = se3.exp(np.array([0.01, 0.02, -0.01, 0.1, 0.0, 0.9]))


def test_motions_that_were_not_measured_from_it_are_composed_with_their_covariances():
    covariance = extrapolation_covariance(0.01, 0.1, 1)
    reference = Reference("view").extend(STEP, covariance).extend(STEP, covariance)
    np.testing.assert_allclose(reference.T_reference_previous, STEP @ STEP)
    np.testing.assert_allclose(reference.T_reference_measured, np.eye(4))
    np.testing.assert_allclose(reference.covariance_previous, se3.compose_covariance(covariance, STEP, covariance))


def test_a_measured_pose_is_certain_and_young_again():
    reference = Reference("view").age(3).extend(STEP, np.eye(6)).update(STEP @ STEP)
    assert reference.age_frames == 0
    assert reference.view == "view"
    np.testing.assert_allclose(reference.T_reference_previous, STEP @ STEP)
    np.testing.assert_allclose(reference.T_reference_measured, STEP @ STEP)
    assert not reference.covariance_previous.any()


@pytest.mark.parametrize("frames", [1, 2, 5])
def test_velocity_is_the_motion_for_each_image(frames):
    reference = Reference("view").update(STEP).age(frames)
    velocity = reference.velocity(STEP @ np.linalg.matrix_power(STEP, frames))
    np.testing.assert_allclose(se3.exp(velocity), STEP, atol=1e-12)


def test_the_deviation_of_an_extrapolation_grows_with_the_images_since():
    once, thrice = (np.sqrt(np.diag(extrapolation_covariance(0.02, 0.2, images))) for images in (1, 3))
    np.testing.assert_allclose(once, [0.02] * 3 + [0.2] * 3)
    np.testing.assert_allclose(thrice, 3 * once)
