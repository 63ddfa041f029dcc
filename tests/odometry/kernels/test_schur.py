"""The reduced camera system is that of the whole Hessian, and back substitution gives the whole solution."""

import numpy as np
import pytest

from odometry.kernels.schur import (
    FIXED,
    POINT,
    POSE,
    add_point_rows,
    compile_add_coupling,
    compile_add_rows,
    eliminate_depth,
    eliminate_point,
    mirror_upper,
)

POSES, CALIBRATION, ROWS = 4, 3, 2
SIZE = POSE * POSES + CALIBRATION
add_rows = compile_add_rows(ROWS, 2, CALIBRATION)
add_depth_coupling = compile_add_coupling(ROWS, 2, CALIBRATION, 1)
add_point_coupling = compile_add_coupling(ROWS, 2, CALIBRATION, POINT)


def observations(rng, count=5):
    """Random residuals of one point: the two poses of each, its Jacobian by the cameras, and its weight."""
    for _ in range(count):
        first, second = np.sort(rng.choice(POSES, 2, replace=False))
        starts = (int(POSE * first), int(POSE * second))
        yield starts, rng.normal(size=(ROWS, 2 * POSE + CALIBRATION)), rng.uniform(0.1, 1.0), rng.normal(size=ROWS)


def scattered(starts, J):
    """The Jacobian by all unknowns of the cameras, (ROWS, SIZE)."""
    full = np.zeros((len(J), SIZE))
    for k, start in enumerate(starts):
        if start != FIXED:
            full[:, start : start + POSE] += J[:, POSE * k : POSE * k + POSE]
    full[:, SIZE - CALIBRATION :] = J[:, 2 * POSE :]
    return full


def dense_solution(rows, residuals, unknowns):
    """Changes of all unknowns by a dense solution of the normal equations, slightly damped like the reduced ones."""
    J, r = np.concatenate(rows), np.concatenate(residuals)
    damping = np.zeros(unknowns)
    damping[:SIZE] = 1e-3
    return np.linalg.solve(J.T @ J + np.diag(damping), -J.T @ r)


@pytest.mark.parametrize("seed", range(8))
def test_rows_come_to_the_upper_triangle_of_the_dense_hessian(seed):
    rng = np.random.default_rng(seed)
    H, b, dense, gradient = np.zeros((SIZE, SIZE)), np.zeros(SIZE), np.zeros((SIZE, SIZE)), np.zeros(SIZE)
    for starts, J, weight, residual in observations(rng):
        starts = (FIXED, starts[1]) if seed % 2 else starts
        add_rows(H, b, starts, J, weight, residual)
        full = scattered(starts, J)
        dense += weight * full.T @ full
        gradient += weight * full.T @ residual
    mirror_upper(H)
    np.testing.assert_allclose(H, dense, atol=1e-12)
    np.testing.assert_allclose(b, gradient, atol=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_eliminated_depths_give_the_solution_of_the_dense_system(seed):
    rng, points = np.random.default_rng(seed), 7
    H, b, gains, offsets = np.zeros((SIZE, SIZE)), np.zeros(SIZE), np.zeros((points, SIZE)), np.zeros(points)
    rows, residuals = [], []
    for i in range(points):
        W, curvature, slope = np.zeros((1, SIZE)), 0.0, 0.0
        for starts, J, weight, residual in observations(rng):
            Jd = rng.normal(size=(ROWS, 1))
            add_rows(H, b, starts, J, weight, residual)
            add_depth_coupling(W, starts, J, Jd, weight)
            curvature += weight * float(Jd[:, 0] @ Jd[:, 0])
            slope += weight * float(Jd[:, 0] @ residual)
            row = np.zeros((ROWS, SIZE + points))
            row[:, :SIZE], row[:, SIZE + i] = scattered(starts, J), Jd[:, 0]
            rows.append(np.sqrt(weight) * row)
            residuals.append(np.sqrt(weight) * residual)
        gains[i], offsets[i] = W[0] / curvature, slope / curvature
        eliminate_depth(H, b, gains[i], offsets[i], curvature, (0, SIZE))
    mirror_upper(H)
    change = np.linalg.solve(H + 1e-3 * np.eye(SIZE), -b)
    expected = dense_solution(rows, residuals, SIZE + points)
    np.testing.assert_allclose(change, expected[:SIZE], atol=1e-8)
    np.testing.assert_allclose(-(offsets + gains @ change), expected[SIZE:], atol=1e-8)


@pytest.mark.parametrize("seed", range(8))
def test_eliminated_points_give_the_solution_of_the_dense_system(seed):
    rng, points = np.random.default_rng(seed), 5
    unknowns = SIZE + POINT * points
    H, b = np.zeros((SIZE, SIZE)), np.zeros(SIZE)
    gains, offsets = np.zeros((points, POINT, SIZE)), np.zeros((points, POINT))
    rows, residuals = [], []
    for i in range(points):
        A, g, W = np.zeros((POINT, POINT)), np.zeros(POINT), np.zeros((POINT, SIZE))
        for starts, J, weight, residual in observations(rng):
            Jp = rng.normal(size=(ROWS, POINT))
            add_rows(H, b, starts, J, weight, residual)
            add_point_rows(A, g, Jp, weight * Jp, residual)
            add_point_coupling(W, starts, J, Jp, weight)
            row = np.zeros((ROWS, unknowns))
            row[:, :SIZE], row[:, SIZE + POINT * i : SIZE + POINT * (i + 1)] = scattered(starts, J), Jp
            rows.append(np.sqrt(weight) * row)
            residuals.append(np.sqrt(weight) * residual)
        information = eliminate_point(H, b, A, g, W, gains[i], offsets[i])
        assert information == pytest.approx(1.0 / np.linalg.inv(A)[2, 2])
    mirror_upper(H)
    change = np.linalg.solve(H + 1e-3 * np.eye(SIZE), -b)
    expected = dense_solution(rows, residuals, unknowns)
    np.testing.assert_allclose(change, expected[:SIZE], atol=1e-8)
    np.testing.assert_allclose(-(offsets + gains @ change).ravel(), expected[SIZE:], atol=1e-8)


def test_a_point_of_unknown_depth_changes_nothing():
    rng = np.random.default_rng(0)
    H, b = rng.normal(size=(SIZE, SIZE)), rng.normal(size=SIZE)
    before = H.copy(), b.copy()
    gain, offset = np.zeros((POINT, SIZE)), np.zeros(POINT)
    A = np.diag([1.0, 1.0, 0.0])
    assert eliminate_point(H, b, A, np.ones(POINT), rng.normal(size=(POINT, SIZE)), gain, offset) == 0.0
    np.testing.assert_array_equal(H, before[0])
    np.testing.assert_array_equal(b, before[1])
    assert not gain.any()
    assert not offset.any()
