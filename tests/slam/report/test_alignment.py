from dataclasses import replace

import numpy as np
import pytest
from evo.core.geometry import umeyama_alignment
from hypothesis import given, settings
from hypothesis import strategies as st

from odometry import se3
from slam.report.alignment import anchored_truth, position_error, similarity

from . import fabricate

WHOLE = fabricate.record()


@pytest.mark.parametrize("with_scale", [False, True])
def test_the_alignment_is_that_of_evo(with_scale):
    R, t, scale = umeyama_alignment(
        WHOLE.odometry[:, :3, 3].T, WHOLE.ground_truth[:, :3, 3].T, with_scale=with_scale
    )
    T = similarity(WHOLE.odometry, WHOLE.ground_truth, with_scale)
    np.testing.assert_allclose(T[:3, :3], scale * R, atol=1e-9)
    np.testing.assert_allclose(T[:3, 3], t, atol=1e-7)


@settings(max_examples=20, deadline=None)
@given(st.lists(st.floats(-3, 3), min_size=6, max_size=6), st.floats(0.2, 5))
def test_a_moved_and_scaled_copy_has_no_error(xi, scale):
    moved = se3.exp(np.array(xi)) @ WHOLE.ground_truth
    moved[:, :3, 3] *= scale
    assert position_error(moved, WHOLE.ground_truth, with_scale=True).max() < 1e-6


def test_a_straight_track_is_not_rolled_about_itself():
    T = similarity(fabricate.straight().odometry, fabricate.straight().ground_truth)
    np.testing.assert_allclose(T, np.eye(4), atol=1e-12)


def test_truth_of_another_world_is_anchored_at_the_first_pose():
    elsewhere = se3.exp(np.array([0.5, 1.0, -2.0, 10.0, 20.0, 30.0])) @ WHOLE.ground_truth
    truth = anchored_truth(replace(WHOLE, ground_truth=elsewhere))
    np.testing.assert_allclose(truth, WHOLE.ground_truth, atol=1e-9)


def test_no_truth_stays_none():
    assert anchored_truth(fabricate.without_truth(WHOLE)) is None
