"""Every Jacobian of the pose graph and of loop geometry, against finite differences."""

from collections.abc import Callable

import numpy as np
import pytest

from odometry import se3
from odometry.camera import StereoCamera
from slam.loop_closing.relative_pose import RelativePoseConfig, _pixel_jacobian, _stereo_pixels, _StereoAlignment
from slam.pose_graph.odometry_chain import OdometryChain, OdometryDriftModel
from slam.pose_graph.optimization.edges import Edges
from slam.pose_graph.optimization.gauss_newton import jacobian_of_errors, whitened_jacobian
from slam.pose_graph.optimization.lie_groups import SE2, SE3, LieGroup, Sim3
from slam.pose_graph.robust.consensus import _bends

GROUPS: dict[str, LieGroup] = {"SE(2)": SE2(), "SE(3)": SE3(), "Sim(3)": Sim3()}
CAMERA = StereoCamera(fx=700.0, fy=710.0, cx=600.0, cy=180.0, baseline=0.54, width=1200, height=370)
CONFIG = RelativePoseConfig(sigma_px=0.4, sigma_disparity_px=0.7)
T_A_B = se3.exp(np.array([0.02, -0.08, 0.01, 0.4, -0.1, 1.2]))
STEP = 1e-6


def differences(function: Callable[[np.ndarray], np.ndarray], size: int) -> np.ndarray:
    """Central differences (..., size) of a function of a small vector (size,) at zero."""
    columns = [(function(STEP * e) - function(-STEP * e)) / (2 * STEP) for e in np.eye(size)]
    return np.stack(columns, axis=-1)


def graph(group: LieGroup, residual: float = 0.0) -> tuple[Edges, np.ndarray]:
    """Random poses with edges between them whose residuals have a size, and information of full rank."""
    rng = np.random.default_rng(3)
    poses = group.exp(rng.normal(size=(5, group.dof)))
    ends = np.array([[0, 1], [1, 2], [2, 3], [3, 4], [0, 3], [4, 1]])
    errors = group.exp(residual * rng.normal(size=(len(ends), group.dof)))
    motions = group.inverse(poses[ends[:, 0]]) @ poses[ends[:, 1]] @ errors
    roots = rng.normal(size=(len(ends), group.dof, group.dof)) + 3 * np.eye(group.dof)
    return Edges(ends[:, 0], ends[:, 1], motions, roots @ np.swapaxes(roots, 1, 2)), poses


def moved(group: LieGroup, poses: np.ndarray, xi: np.ndarray) -> np.ndarray:
    return poses @ group.exp(xi.reshape(len(poses), group.dof))


@pytest.mark.parametrize("group", GROUPS)
def test_the_jacobian_of_an_edge_is_exact_where_its_residual_is_zero(group: str) -> None:
    edges, poses = graph(GROUPS[group])
    numeric = differences(
        lambda xi: edges.errors(moved(edges.group, poses, xi)).ravel(), poses.shape[0] * edges.group.dof
    )
    np.testing.assert_allclose(jacobian_of_errors(poses, edges).toarray(), numeric, atol=1e-7)


@pytest.mark.parametrize("group", GROUPS)
def test_the_whitened_jacobian_is_that_of_whitened_errors(group: str) -> None:
    edges, poses = graph(GROUPS[group])

    def whitened(xi: np.ndarray) -> np.ndarray:
        errors = edges.errors(moved(edges.group, poses, xi))
        return np.einsum("mij,mj->mi", edges.sqrt_information, errors).ravel()

    numeric = differences(whitened, poses.shape[0] * edges.group.dof)
    np.testing.assert_allclose(whitened_jacobian(poses, edges).toarray(), numeric, atol=1e-6)


@pytest.mark.parametrize("group", GROUPS)
def test_the_error_of_the_jacobian_grows_with_the_residual_as_documented(group: str) -> None:
    """The inverse right Jacobian of the logarithm is I + ad(e) / 2 + ...: half the residual, not more."""
    size = 0.01
    edges, poses = graph(GROUPS[group], size)
    numeric = differences(
        lambda xi: edges.errors(moved(edges.group, poses, xi)).ravel(), poses.shape[0] * edges.group.dof
    )
    analytic = jacobian_of_errors(poses, edges).toarray()
    deviation = np.abs(analytic - numeric).max() / np.abs(numeric).max()
    assert 0.0 < deviation < 3 * size


@pytest.mark.parametrize("group", GROUPS)
def test_the_gradient_of_chi_square_points_uphill(group: str) -> None:
    edges, poses = graph(GROUPS[group], 1e-3)
    jacobian = whitened_jacobian(poses, edges).toarray()
    errors = np.einsum("mij,mj->mi", edges.sqrt_information, edges.errors(poses)).ravel()
    chi2 = differences(lambda xi: np.array([edges.chi2(moved(edges.group, poses, xi)).sum()]), jacobian.shape[1])[0]
    np.testing.assert_allclose(2 * jacobian.T @ errors, chi2, atol=2e-2 * np.abs(chi2).max())


@pytest.mark.parametrize("group", GROUPS)
def test_a_bend_makes_the_loop_exact_to_first_order(group: str) -> None:
    edges, poses = graph(GROUPS[group], 1e-4)
    support, loops = edges[:4], edges[4:]
    bends = _bends(support, poses, loops)
    for k in range(len(loops)):
        xi = np.concatenate([np.zeros(edges.group.dof), bends[:, k]])
        assert np.abs(loops[k : k + 1].errors(moved(edges.group, poses, xi))).max() < 1e-6


def test_odometrys_bias_jacobian_is_that_of_a_constant_error_per_metre() -> None:
    motions = [se3.exp(np.array([0.01, 0.06 * np.sin(k / 5), 0.0, 0.0, 0.05, 1.0])) for k in range(30)]
    model = OdometryDriftModel(sigma_m_per_m=0.02, sigma_rad_per_m=3e-4)
    chain = OdometryChain(model)
    for T in motions:
        chain.append(T, np.eye(6))

    def last(bias: np.ndarray) -> np.ndarray:
        T = np.eye(4)
        for motion in motions[10:]:
            T = T @ motion @ se3.exp(np.linalg.norm(motion[:3, 3]) * bias)
        return se3.log(se3.inverse(se3.inverse(chain[10]) @ chain[30]) @ T)

    J = differences(last, 6)
    np.testing.assert_allclose(chain.bias_covariance(10, 30), J @ np.diag(model.variances) @ J.T, rtol=1e-4, atol=1e-9)


@pytest.fixture
def points() -> np.ndarray:
    return np.random.default_rng(0).uniform([-8, -3, 5], [8, 2, 40], (20, 3))


def test_the_jacobian_of_stereo_pixels(points: np.ndarray) -> None:
    numeric = differences(lambda d: _stereo_pixels(CAMERA, points + d), 3)
    np.testing.assert_allclose(_pixel_jacobian(CAMERA, points), numeric, rtol=1e-5, atol=1e-5)


def point_of(pixels: np.ndarray) -> np.ndarray:
    """Points (K, 3) of stereo pixels (K, 3)."""
    z = CAMERA.fx * CAMERA.baseline / pixels[:, 2]
    x, y = (pixels[:, 0] - CAMERA.cx) * z / CAMERA.fx, (pixels[:, 1] - CAMERA.cy) * z / CAMERA.fy
    return np.stack([x, y, z], axis=1)


def predicted(T_a_b: np.ndarray, pixels_a: np.ndarray) -> np.ndarray:
    """Stereo pixels in b of landmarks by their stereo pixels in a."""
    return _stereo_pixels(CAMERA, se3.transform(se3.inverse(T_a_b), point_of(pixels_a)))


def whitening(points: np.ndarray) -> np.ndarray:
    """Inverse Cholesky factors of the noise of both images, by differences."""
    pixels_a = _stereo_pixels(CAMERA, points)
    noise = np.diag(np.square([CONFIG.sigma_px, CONFIG.sigma_px, CONFIG.sigma_disparity_px]))
    by_a = differences(lambda d: predicted(T_A_B, pixels_a + d), 3)
    return np.linalg.inv(np.linalg.cholesky(noise + by_a @ noise @ np.swapaxes(by_a, 1, 2)))


@pytest.fixture
def alignment(points: np.ndarray) -> _StereoAlignment:
    """Landmarks seen without noise from a and b, linearised at the true pose."""
    system = _StereoAlignment(CAMERA, points, se3.transform(se3.inverse(T_A_B), points), CONFIG)
    system.linearize(T_A_B)
    return system


def test_the_jacobian_of_the_alignment_by_the_pose(points: np.ndarray, alignment: _StereoAlignment) -> None:
    pixels_a = _stereo_pixels(CAMERA, points)
    numeric = whitening(points) @ differences(lambda xi: predicted(T_A_B @ se3.exp(xi), pixels_a), 6)
    np.testing.assert_allclose(alignment._jacobian, numeric, rtol=1e-4, atol=1e-4)


def test_the_effect_of_one_pixel_more_of_disparity(points: np.ndarray, alignment: _StereoAlignment) -> None:
    pixels_a, one = _stereo_pixels(CAMERA, points), np.array([0.0, 0.0, 1.0])

    def error(more: np.ndarray) -> np.ndarray:
        return predicted(T_A_B, pixels_a) + more[0] * one - predicted(T_A_B, pixels_a + more[0] * one)

    numeric = whitening(points) @ differences(error, 1)
    np.testing.assert_allclose(alignment._disparity_errors(), numeric[:, :, 0], rtol=1e-4, atol=1e-4)


def test_one_step_finds_a_pose_nearby(points: np.ndarray) -> None:
    system = _StereoAlignment(CAMERA, points, se3.transform(se3.inverse(T_A_B), points), CONFIG)
    off = np.array([1e-4, -2e-4, 1e-4, 1e-3, 2e-3, -1e-3])
    system.linearize(T_A_B @ se3.exp(off))
    np.testing.assert_allclose(system.step(np.ones(len(points))), -off, atol=2e-5)
