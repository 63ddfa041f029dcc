"""Every Jacobian of the three adjustments is the central difference of its residuals."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from odometry import se3
from odometry.kernels import mono_bundle_equations, sliding_window_equations, two_view_equations
from odometry.kernels.reprojection import ANCHOR, BY_POINT, ERROR, FRAME, relative_pose, subtract_previous
from odometry.kernels.schur import POINT, POSE

CAMERA = np.array([700.0, 680.0, 600.0, 180.0, 0.5])
STEP = 1e-6
seeds = st.integers(0, 100_000)


def difference(residuals, unknowns):
    """Central differences (R, U) of a function of changes (U,) at zero."""
    columns = []
    for k in range(unknowns):
        change = np.zeros(unknowns)
        change[k] = STEP
        columns.append((residuals(change) - residuals(-change)) / (2 * STEP))
    return np.stack(columns, axis=1)


def random_poses(rng):
    """Poses (4, 4) of an anchor and of a frame ahead of it, both anywhere in the map."""
    anchor = se3.exp(rng.normal(0, [0.5] * 3 + [3.0] * 3))
    return anchor, anchor @ se3.exp(rng.normal(0, [0.05] * 3 + [0.5] * 3))


def relative(anchor, frame):
    out = np.zeros((3, 4))
    relative_pose(anchor, frame, out)
    return out


@given(seeds)
def test_the_relative_pose_is_that_of_the_matrices(seed):
    anchor, frame = random_poses(np.random.default_rng(seed))
    np.testing.assert_allclose(relative(anchor, frame), (se3.inverse(frame) @ anchor)[:3], atol=1e-12)


@settings(max_examples=50, deadline=None)
@given(seeds)
def test_the_jacobian_of_the_two_view_adjustment(seed):
    rng = np.random.default_rng(seed)
    T = se3.exp(rng.normal(0, [0.05] * 3 + [0.5] * 3))
    calibration, depth = rng.normal(0, 3.0, 15), rng.uniform(1 / 80, 1 / 6)
    pixels = rng.uniform([0, 0], [1200, 370], (4, 2))

    def observe(change):
        out = np.zeros(6), np.zeros((6, 21)), np.zeros(6), np.zeros((4, 2, 3))
        moved = se3.exp(change[:6]) @ T
        two_view_equations.observe(CAMERA, pixels, depth + change[21], moved, calibration + change[6:21], out)
        return out

    # The pixels of a residual's field do not depend on the calibration, so the differences are exact to second order.
    _, J, Jd, _ = observe(np.zeros(22))
    expected = difference(lambda change: observe(change)[0], 22)
    np.testing.assert_allclose(np.column_stack([J, Jd]), expected, rtol=1e-5, atol=1e-4)


@settings(max_examples=50, deadline=None)
@given(seeds)
def test_the_jacobian_of_the_sliding_window(seed):
    rng = np.random.default_rng(seed)
    anchor, frame = random_poses(rng)
    first, pixel = (np.array([u, u - d, v]) for u, d, v in rng.uniform([0, 4, 0], [1200, 60, 370], (2, 3)))
    depth = rng.uniform(1 / 80, 1 / 6)

    def observe(change):
        out = np.zeros((3, BY_POINT + 1))
        T = relative(anchor @ se3.exp(change[:6]), frame @ se3.exp(change[6:12]))
        sliding_window_equations.observe(CAMERA, first, pixel, depth + change[12], T, out)
        return out

    expected = difference(lambda change: observe(change)[:, ERROR], 13)
    np.testing.assert_allclose(observe(np.zeros(13))[:, ANCHOR:], expected, rtol=1e-5, atol=1e-4)


@settings(max_examples=50, deadline=None)
@given(seeds)
def test_the_jacobian_of_the_monocular_bundle(seed):
    rng = np.random.default_rng(seed)
    anchor, frame = random_poses(rng)
    first, pixel = rng.uniform([0, 0], [1200, 370], (2, 2))
    point, lens = np.array([*rng.normal(0, 1.0, 2), rng.uniform(1 / 80, 1 / 6)]), rng.normal(0, 5.0, 3)

    def observe(change):
        out = np.zeros((2, BY_POINT + 6))
        T = relative(anchor @ se3.exp(change[:6]), frame @ se3.exp(change[6:12]))
        mono_bundle_equations.observe(CAMERA[:4], first, pixel, point + change[12:15], T, lens + change[15:], out)
        return out

    expected = difference(lambda change: observe(change)[:, ERROR], 18)
    np.testing.assert_allclose(observe(np.zeros(18))[:, ANCHOR:], expected, rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_an_increment_is_the_error_less_a_share_of_the_error_before(share):
    rng = np.random.default_rng(3)
    now, before = rng.normal(size=(2, 2, BY_POINT + POINT + 3))
    residual, J, Jp = np.zeros(2), np.zeros((2, 3 * POSE + 3)), np.zeros((2, POINT))
    subtract_previous(now, before, (share, share), residual, J, Jp)
    np.testing.assert_allclose(residual, now[:, ERROR] - share * before[:, ERROR])
    np.testing.assert_allclose(J[:, :6], (now - share * before)[:, ANCHOR : ANCHOR + 6])
    np.testing.assert_allclose(J[:, 6:12], -share * before[:, FRAME : FRAME + 6])
    np.testing.assert_allclose(J[:, 12:18], now[:, FRAME : FRAME + 6])
    np.testing.assert_allclose(np.hstack([Jp, J[:, 18:]]), (now - share * before)[:, BY_POINT:])
