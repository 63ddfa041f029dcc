"""Motions agree with the matrix exponential, with their own inverses and with chance."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.linalg import expm, logm

from odometry import se3

tangents = arrays(np.float64, 6, elements=st.floats(-1.7, 1.7, allow_subnormal=False))


def twist(xi):
    """The (4, 4) matrix of a tangent vector."""
    matrix = np.zeros((4, 4))
    matrix[:3, :3], matrix[:3, 3] = se3.skew(xi[:3]), xi[3:]
    return matrix


@given(tangents)
def test_log_undoes_exp(xi):
    np.testing.assert_allclose(se3.log(se3.exp(xi)), xi, atol=1e-8)


@given(tangents)
def test_exp_is_the_matrix_exponential(xi):
    np.testing.assert_allclose(se3.exp(xi), expm(twist(xi)), atol=1e-10)


@pytest.mark.parametrize("scale", [1.0, 1e-3])
def test_log_is_the_matrix_logarithm(scale):
    T = se3.exp(scale * np.array([0.3, -0.7, 0.5, 1.0, -2.0, 0.4]))
    np.testing.assert_allclose(twist(se3.log(T)), logm(T).real, atol=1e-10)


@given(tangents)
def test_a_motion_times_its_inverse_is_nothing(xi):
    T = se3.exp(xi)
    np.testing.assert_allclose(T @ se3.inverse(T), np.eye(4), atol=1e-12)


def test_a_stack_is_inverted_one_by_one():
    poses = np.stack([se3.exp(xi) for xi in np.random.default_rng(1).normal(size=(5, 6))])
    np.testing.assert_allclose(se3.inverse(poses), np.linalg.inv(poses), atol=1e-12)


@given(tangents, tangents)
def test_the_adjoint_moves_a_perturbation_to_the_other_side(a, xi):
    T = se3.exp(a)
    np.testing.assert_allclose(T @ se3.exp(xi), se3.exp(se3.adjoint(T) @ xi) @ T, atol=1e-9)


@given(tangents)
def test_the_angle_is_the_length_of_the_rotation_vector(xi):
    assert se3.angle(se3.exp(xi)) == pytest.approx(np.linalg.norm(xi[:3]), abs=1e-7)


def test_transformed_points_are_those_of_homogeneous_coordinates():
    T, points = se3.exp(np.array([0.1, 0.2, 0.3, 1, 2, 3])), np.random.default_rng(2).normal(size=(7, 3))
    homogeneous = np.c_[points, np.ones(7)] @ T.T
    np.testing.assert_allclose(se3.transform(T, points), homogeneous[:, :3], atol=1e-12)


@given(arrays(np.float64, 3, elements=st.floats(-1.5, 1.5)))
def test_the_left_jacobian_is_the_derivative_of_exp(w):
    small = np.array([1e-6, -2e-6, 1.5e-6])
    change = se3.exp(np.r_[w + small, 0, 0, 0]) @ se3.inverse(se3.exp(np.r_[w, 0, 0, 0]))
    np.testing.assert_allclose(se3.log(change)[:3], se3.left_jacobian(w) @ small, atol=1e-11)


def test_composed_covariance_is_that_of_many_draws():
    rng = np.random.default_rng(3)
    T_a, T_b = se3.exp(np.array([0.1, -0.4, 0.2, 2, 0, 5])), se3.exp(np.array([0, 0.3, 0.1, -1, 1, 3]))
    roots = [0.01 * rng.normal(size=(6, 6)) for _ in range(2)]
    draws = [[se3.exp(xi) for xi in rng.normal(size=(6000, 6)) @ root.T] for root in roots]
    undone = se3.inverse(T_a @ T_b)
    errors = [se3.log(undone @ T_a @ a @ T_b @ b) for a, b in zip(*draws, strict=True)]
    expected = se3.compose_covariance(roots[0] @ roots[0].T, T_b, roots[1] @ roots[1].T)
    np.testing.assert_allclose(np.cov(np.array(errors).T), expected, atol=0.05 * np.abs(expected).max())


@pytest.mark.parametrize("scale", [1e-9, 1e-5, 1e-3, 1.0])
def test_a_stack_has_the_logarithms_exponentials_and_adjoints_of_its_poses(scale):
    xi = scale * np.random.default_rng(4).normal(size=(3, 5, 6))
    T = se3.exp(xi)
    assert T.shape == (3, 5, 4, 4)
    one_by_one = [[(se3.exp(each), se3.log(se3.exp(each)), se3.adjoint(se3.exp(each))) for each in row] for row in xi]
    for k, stacked in enumerate((T, se3.log(T), se3.adjoint(T))):
        np.testing.assert_allclose(stacked, [[each[k] for each in row] for row in one_by_one], atol=1e-12)


def test_an_empty_stack_stays_empty():
    none = np.zeros((0, 4, 4))
    assert se3.log(none).shape == (0, 6)
    assert se3.exp(np.zeros((0, 6))).shape == se3.inverse(none).shape == (0, 4, 4)
    assert se3.adjoint(none).shape == (0, 6, 6)


@given(arrays(np.float64, (4, 3), elements=st.floats(-5, 5)), arrays(np.float64, 3, elements=st.floats(-5, 5)))
def test_skew_matrices_are_the_cross_product(w, p):
    np.testing.assert_allclose(se3.skew(w) @ p, np.cross(w, p), atol=1e-12)


def test_orthonormalize_takes_rounding_errors_out_of_rotations():
    T = se3.exp(np.random.default_rng(5).normal(size=(4, 6)))
    spoiled = T + 1e-9 * np.random.default_rng(6).normal(size=T.shape)
    R = se3.orthonormalize(spoiled)[:, :3, :3]
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.tile(np.eye(3), (4, 1, 1)), atol=1e-14)
    np.testing.assert_allclose(R, T[:, :3, :3], atol=1e-8)
