"""How uncertain odometry is between two frames: against random trials and against GTSAM."""

import gtsam
import numpy as np
import pytest

from odometry import se3
from slam.pose_graph.odometry_chain import OdometryChain, OdometryDriftModel

NO_DRIFT = OdometryDriftModel(sigma_m_per_m=0.0, sigma_rad_per_m=0.0)
COVARIANCE = np.diag(np.square([2e-3, 3e-3, 1e-3, 0.02, 0.01, 0.04]))


def bend(count: int) -> list[np.ndarray]:
    """Motions of about a metre forward on a bending, climbing road."""
    return [se3.exp(np.array([0.01, 0.06 * np.sin(k / 5), 0.0, 0.0, 0.05, 1.0])) for k in range(count)]


def chain(motions: list[np.ndarray], model: OdometryDriftModel = NO_DRIFT) -> OdometryChain:
    out = OdometryChain(model)
    for T in motions:
        out.append(T, COVARIANCE)
    return out


def test_the_chain_composes_its_motions() -> None:
    motions = bend(5)
    between = chain(motions).between(1, 4)
    np.testing.assert_allclose(between.T_first_second, motions[1] @ motions[2] @ motions[3], atol=1e-12)
    assert between.path_length_m == pytest.approx(3 * np.hypot(1.0, 0.05), abs=1e-3)


def test_covariance_is_that_of_composing_step_by_step() -> None:
    motions = bend(30)
    expected = np.zeros((6, 6))
    for T in motions[10:25]:
        expected = se3.compose_covariance(expected, T, COVARIANCE)
    np.testing.assert_allclose(chain(motions).between(10, 25).covariance, expected, rtol=1e-9, atol=1e-15)


def test_covariance_is_that_of_random_trials() -> None:
    rng, motions = np.random.default_rng(1), bend(40)
    between = chain(motions).between(0, 40)
    noise = rng.normal(size=(1500, 40, 6)) * np.sqrt(np.diag(COVARIANCE))
    errors = []
    for trial in noise:
        T = np.eye(4)
        for motion, xi in zip(motions, trial, strict=True):
            T = T @ motion @ se3.exp(xi)
        errors.append(se3.log(se3.inverse(between.T_first_second) @ T))
    nees = np.einsum("ni,ij,nj->n", errors, np.linalg.inv(between.covariance), errors)
    assert nees.mean() == pytest.approx(6.0, abs=0.4)


def test_covariance_is_gtsams_marginal() -> None:
    motions = bend(30)
    graph, values, T = gtsam.NonlinearFactorGraph(), gtsam.Values(), np.eye(4)
    graph.add(gtsam.PriorFactorPose3(0, gtsam.Pose3(), gtsam.noiseModel.Isotropic.Sigma(6, 1e-8)))
    values.insert(0, gtsam.Pose3())
    for k, motion in enumerate(motions):
        T = T @ motion
        noise = gtsam.noiseModel.Gaussian.Covariance(COVARIANCE)
        graph.add(gtsam.BetweenFactorPose3(k, k + 1, gtsam.Pose3(motion), noise))
        values.insert(k + 1, gtsam.Pose3(T))
    marginal = gtsam.Marginals(graph, values).marginalCovariance(30)
    np.testing.assert_allclose(chain(motions).between(0, 30).covariance, marginal, rtol=1e-5, atol=1e-9)


def test_a_lasting_bias_stays_within_the_covariance() -> None:
    motions = bend(400)
    bias = np.array([0.0, 1e-4, 0.0, 0.0, 0.0, 0.01])  # one sigma of the default model, for the whole path
    between = chain(motions, OdometryDriftModel()).between(0, 400)
    T = np.eye(4)
    for motion in motions:
        T = T @ motion @ se3.exp(bias)
    error = se3.log(se3.inverse(between.T_first_second) @ T)
    assert error @ np.linalg.solve(between.covariance, error) < 2.5  # two directions biased by one sigma each


def test_standing_still_adds_no_drift() -> None:
    still = chain([np.eye(4)] * 10, OdometryDriftModel()).between(0, 10)
    np.testing.assert_allclose(still.covariance, 10 * COVARIANCE, rtol=1e-12)
    assert still.path_length_m == 0.0
