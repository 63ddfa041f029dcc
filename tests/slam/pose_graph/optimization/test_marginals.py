"""How sure the poses are: against closed form, dense inversion and random trials."""

import numpy as np
import pytest

from odometry import se3
from slam.loop_closing.loop_closer import LoopClosure
from slam.pose_graph.odometry_chain import OdometryDriftModel
from slam.pose_graph.pose_graph import PoseGraph, PoseGraphConfig

from ...laps import LOOP_COVARIANCE, STEP_COVARIANCE, Drive, laps, noise

DRIFT = OdometryDriftModel(sigma_m_per_m=0.02, sigma_rad_per_m=1e-3, correlation_length_m=3.0)
CONFIG = PoseGraphConfig(drift=DRIFT)
SMALL = laps(side=10, laps=1.5)
LOOPS = [SMALL.loops[0], SMALL.loops[4]]


def exact(loops: list[LoopClosure]) -> PoseGraph:
    """A drive without errors, so that it is solved where it starts."""
    motions = list(se3.inverse(SMALL.poses[:-1]) @ SMALL.poses[1:])
    true = [
        LoopClosure(k.query, k.match, se3.inverse(SMALL.poses[k.match]) @ SMALL.poses[k.query], k.covariance, 50)
        for k in loops
    ]
    return Drive(SMALL.poses, motions, []).graph(true, CONFIG)


def dense(graph: PoseGraph) -> np.ndarray:
    """Covariances (N, 6, 6) by inverting the whole information matrix; the bias as a sandwich of matrices."""
    count = len(graph)
    poses = graph.odometry_poses()
    edges = [(k, k + 1, DRIFT.of_motion(T, C)) for k, (T, C) in enumerate(graph.odometry)]
    edges += [(k.match, k.query, graph.config.with_noise_floor(k).covariance) for k in graph.loops]
    H, right = np.zeros((6 * count, 6 * count)), np.zeros((6 * count, 6))
    for number, (a, b, C) in enumerate(edges):
        J = np.zeros((6, 6 * count))
        J[:, 6 * a : 6 * a + 6] = -se3.adjoint(se3.inverse(poses[b]) @ poses[a])
        J[:, 6 * b : 6 * b + 6] = np.eye(6)
        H += J.T @ np.linalg.inv(C) @ J
        if number < count - 1:
            step = np.linalg.norm(graph.odometry[number][0][:3, 3])
            right += J.T @ np.linalg.inv(C) * step * np.sqrt(DRIFT.variances)
    inverse = np.linalg.inv(H[6:, 6:])
    shift = inverse @ right[6:]
    whole = inverse + shift @ shift.T
    blocks = [whole[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] for k in range(count - 1)]
    return np.array([np.zeros((6, 6)), *blocks])


def test_without_loops_they_are_those_of_the_chain_in_closed_form() -> None:
    graph = exact([])
    marginal = graph.covariances(graph.optimize("none"))
    np.testing.assert_allclose(marginal, graph.odometry_covariances(), rtol=1e-6, atol=1e-9)


def test_with_loops_they_are_those_of_dense_inversion() -> None:
    graph = exact(LOOPS)
    np.testing.assert_allclose(graph.covariances(graph.optimize("none")), dense(graph), rtol=1e-6, atol=1e-9)


def test_a_loop_never_increases_the_covariance_by_independent_errors() -> None:
    free = PoseGraphConfig(drift=OdometryDriftModel(0.0, 0.0))
    before = SMALL.graph([], free).odometry_covariances()
    graph = SMALL.graph(LOOPS, free)
    after = graph.covariances(graph.optimize("none"))
    assert np.linalg.eigvalsh(before - after).min() > -1e-9
    assert np.trace(after[LOOPS[0].query]) < 0.5 * np.trace(before[LOOPS[0].query])


def test_a_loop_that_was_left_out_changes_nothing() -> None:
    false = LoopClosure(55, 20, np.eye(4), LOOP_COVARIANCE, 30)
    with_it, without = SMALL.graph([*LOOPS, false]), SMALL.graph(LOOPS)
    one, other = with_it.optimize("gnc"), without.optimize("gnc")
    assert not one.kept[-1]
    np.testing.assert_allclose(with_it.covariances(one), without.covariances(other), rtol=1e-3, atol=1e-9)


@pytest.mark.parametrize("loops", [0, 2])
def test_errors_are_as_large_as_the_covariances_say(loops: int) -> None:
    """NEES of the last pose and of the middle over random drives with passing and lasting errors."""
    rng, chosen, nees = np.random.default_rng(7), LOOPS[:loops], []
    true = se3.inverse(SMALL.poses[:-1]) @ SMALL.poses[1:]
    covariance = DRIFT.of_motion(true[0], STEP_COVARIANCE)
    for _ in range(80):
        bias = rng.normal(size=6) * np.sqrt(DRIFT.variances)
        motions = [T @ se3.exp(np.linalg.norm(T[:3, 3]) * bias + noise(rng, covariance)) for T in true]
        soft = [(k, CONFIG.with_noise_floor(k).covariance) for k in chosen]
        measured = [
            LoopClosure(
                k.query,
                k.match,
                se3.inverse(SMALL.poses[k.match]) @ SMALL.poses[k.query] @ se3.exp(noise(rng, C)),
                LOOP_COVARIANCE,
                50,
            )
            for k, C in soft
        ]
        graph = Drive(SMALL.poses, motions, []).graph(measured, CONFIG)
        result = graph.optimize("none")
        sure = graph.covariances(result)
        for frame in (30, 60):
            error = se3.log(se3.inverse(SMALL.poses[frame]) @ result.poses[frame])
            nees.append(error @ np.linalg.solve(sure[frame], error))
    # 160 of 6 degrees of freedom: mean 6, its standard deviation 0.3, more as the two frames share errors
    assert np.mean(nees) == pytest.approx(6.0, abs=0.9)


def test_two_runs_give_the_same_bits() -> None:
    one, two = (SMALL.graph(LOOPS) for _ in range(2))
    assert one.covariances(one.optimize()).tobytes() == two.covariances(two.optimize()).tobytes()


def test_a_single_pose_is_held() -> None:
    graph = PoseGraph()
    np.testing.assert_allclose(graph.covariances(graph.optimize()), np.zeros((1, 6, 6)), atol=1e-9)
