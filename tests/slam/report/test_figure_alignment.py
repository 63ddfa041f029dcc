from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from odometry import se3
from slam.evaluation.trajectory_errors import absolute_trajectory_error
from slam.report.trajectory_figure import align_trajectory, anchor_ground_truth, position_errors

from . import fabricate

WHOLE = fabricate.record()


def test_the_errors_drawn_are_those_of_the_ate():
    errors = position_errors(WHOLE.odometry, WHOLE.ground_truth)
    ate = absolute_trajectory_error(WHOLE.odometry, WHOLE.ground_truth)
    assert np.sqrt((errors**2).mean()) == pytest.approx(ate)


@settings(max_examples=20, deadline=None)
@given(st.lists(st.floats(-3, 3), min_size=6, max_size=6), st.floats(0.2, 5))
def test_a_moved_and_scaled_copy_has_no_error(xi, scale):
    moved = se3.exp(np.array(xi)) @ WHOLE.ground_truth
    moved[:, :3, 3] *= scale
    assert position_errors(moved, WHOLE.ground_truth, with_scale=True).max() < 1e-6


@pytest.mark.parametrize("turn", [0.0, 1.0, 3.0])
def test_a_straight_track_is_not_rolled_about_itself(turn):
    straight = fabricate.straight().odometry
    T = se3.exp(np.array([0.1, -0.2, turn, 5.0, 6.0, 7.0]))
    found = align_trajectory(straight, T @ straight)
    np.testing.assert_allclose(found.R, T[:3, :3], atol=1e-9)
    np.testing.assert_allclose(found.t, T[:3, 3], atol=1e-7)


def test_a_standing_camera_is_turned_by_its_orientation():
    T = se3.exp(np.array([0.1, -0.2, 0.3, 5.0, 6.0, 7.0]))
    np.testing.assert_allclose(align_trajectory(np.eye(4)[None], T[None], True).R, T[:3, :3], atol=1e-9)


def test_truth_of_another_world_is_anchored_at_the_first_pose():
    elsewhere = se3.exp(np.array([0.5, 1.0, -2.0, 10.0, 20.0, 30.0])) @ WHOLE.ground_truth
    truth = anchor_ground_truth(replace(WHOLE, ground_truth=elsewhere))
    np.testing.assert_allclose(truth, WHOLE.ground_truth, atol=1e-9)


def test_no_truth_stays_none():
    assert anchor_ground_truth(fabricate.without_truth(WHOLE)) is None
