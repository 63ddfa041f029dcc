"""Scale that drifts is found by loops that compare units, and taken out with the drift of the poses."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from odometry import se3
from slam.evaluation.trajectory_errors import absolute_trajectory_error
from slam.loop_closing.loop_closer import LoopClosure
from slam.loop_closing.relative_pose import ScaleRatio
from slam.pose_graph.odometry_chain import OdometryDriftModel, chain_motions
from slam.pose_graph.optimization.sim3 import (
    SimilarityEdge,
    estimate_log_scales,
    optimize_sim3,
    scale_variances,
    with_scale_variance,
)
from slam.pose_graph.pose_graph import PoseGraph, PoseGraphConfig

LAP, COUNT = 100, 200
STEP = se3.exp(np.array([0.0, 2 * np.pi / LAP, 0.0, 0.0, 0.0, 1.0]))
TRUTH = chain_motions([STEP] * (COUNT - 1))
MOTION_COVARIANCE = np.diag([1e-7] * 3 + [1e-5] * 3)
LOOP_COVARIANCE = np.diag([4e-6] * 3 + [1e-3] * 3)


def between(poses, scales, first, second):
    """T_first_second of similarities: in the first one's frame and unit."""
    T = se3.inverse(poses[first]) @ poses[second]
    T[:3, 3] /= scales[first]
    return T


def loop(poses, logs, query, match, sigma=0.01):
    T = between(poses, np.exp(logs), match, query)
    return LoopClosure(query, match, T, LOOP_COVARIANCE, 50, scale=ScaleRatio(logs[query] - logs[match], sigma))


def graph_of(logs, loops, scale_drift=0.01):
    graph = PoseGraph(PoseGraphConfig(drift=OdometryDriftModel(sigma_m_per_m=0.03), scale_drift=scale_drift))
    for k in range(COUNT - 1):
        graph.add_odometry(between(TRUTH, np.exp(logs), k, k + 1), MOTION_COVARIANCE)
    for closure in loops:
        graph.add_loop(closure)
    return graph


@pytest.fixture(scope="module")
def drifting():
    """Logarithm of each frame's unit: steadily shorter by a third over two laps."""
    return np.linspace(0.0, np.log(0.67), COUNT)


@pytest.fixture(scope="module")
def laps(drifting):
    loops = [loop(TRUTH, drifting, query, query - LAP) for query in range(LAP, COUNT, 4)]
    graph = graph_of(drifting, loops)
    return graph, graph.optimize()


def test_scale_drift_is_corrected_with_the_poses(laps, drifting):
    graph, result = laps
    assert absolute_trajectory_error(graph.odometry_poses(), TRUTH, "sim3") > 1.5
    assert result.kept.all()
    assert absolute_trajectory_error(result.poses, TRUTH, "sim3") < 0.3
    assert np.abs(np.log(result.scales) - drifting).max() < 0.05


def test_the_first_frame_keeps_its_place_and_its_unit(laps):
    _, result = laps
    np.testing.assert_allclose(result.poses[0], np.eye(4), atol=1e-5)
    assert result.scales[0] == pytest.approx(1.0, abs=1e-5)


def test_points_of_one_place_meet_though_they_were_measured_in_other_units(laps, drifting):
    _, result = laps
    point_world = se3.transform(TRUTH[150], np.array([[1.0, -2.0, 12.0]]))
    seen = [se3.transform(se3.inverse(TRUTH[k]), point_world) / np.exp(drifting[k]) for k in (50, 150)]
    here = [se3.transform(result.similarities[k], each) for k, each in zip((50, 150), seen, strict=True)]
    np.testing.assert_allclose(here[0], here[1], atol=0.2)


def test_a_stereo_graph_has_no_scale_drift(drifting):
    level = np.zeros(COUNT)
    loops = [loop(TRUTH, level, query, query - LAP) for query in range(LAP, COUNT, 20)]
    result = graph_of(level, loops, scale_drift=0.0).optimize()
    np.testing.assert_array_equal(result.scales, 1.0)
    np.testing.assert_array_equal(result.similarities, result.poses)


def test_loops_without_a_measured_scale_change_no_scale():
    plain = [LoopClosure(150, 50, np.eye(4), LOOP_COVARIANCE, 50)]
    np.testing.assert_array_equal(estimate_log_scales(np.ones(COUNT - 1), plain, 0.01), 0.0)


def test_a_false_scale_measurement_among_true_ones_changes_no_scale(drifting):
    true = [loop(TRUTH, drifting, query, query - LAP) for query in range(LAP, COUNT, 4)]
    false = LoopClosure(160, 20, np.eye(4), LOOP_COVARIANCE, 50, scale=ScaleRatio(1.5, 0.01))
    steps = np.ones(COUNT - 1)
    difference = estimate_log_scales(steps, [*true, false], 0.01) - estimate_log_scales(steps, true, 0.01)
    assert np.abs(difference).max() < 0.01


def test_drift_between_loops_is_spread_evenly(drifting):
    logs = estimate_log_scales(np.ones(COUNT - 1), [loop(TRUTH, drifting, COUNT - 1, 0, 1e-4)], 0.01)
    np.testing.assert_allclose(logs, drifting, atol=1e-3)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_exact_similarities_are_found_from_a_wrong_start(seed):
    """Gauge: the first node is held, whatever it is, and all others follow."""
    rng = np.random.default_rng(seed)
    poses = np.array([se3.exp(rng.normal(0, [0.4] * 3 + [2.0] * 3)) for _ in range(6)])
    scales = np.exp(rng.normal(0, 0.3, 6))
    pairs = [(k, k + 1) for k in range(5)] + [(0, 3), (1, 5)]
    covariance = with_scale_variance(np.eye(6) * 1e-2, 0.1)
    edges = [
        SimilarityEdge(i, j, between(poses, scales, i, j), float(np.log(scales[j] / scales[i])), covariance)
        for i, j in pairs
    ]
    start = np.array([poses[0], *(T @ se3.exp(rng.normal(0, 0.1, 6)) for T in poses[1:])])
    found, scales = optimize_sim3(edges, start, scales * np.exp([0.0, *rng.normal(0, 0.1, 5)]))
    np.testing.assert_allclose(found, poses, atol=1e-4)
    np.testing.assert_allclose(scales, scales, rtol=1e-4)


def test_a_node_without_edges_stays_where_it_is():
    T = np.eye(4)
    away = se3.exp(np.array([0.1, 0.2, 0.3, 1.0, 2.0, 3.0]))
    edge = SimilarityEdge(0, 1, T, 0.0, with_scale_variance(np.eye(6), 1.0))
    poses, scales = optimize_sim3([edge], np.array([T, T, away]), np.array([1.0, 1.0, 2.0]))
    np.testing.assert_allclose(poses[2], away, atol=1e-9)
    assert scales[2] == pytest.approx(2.0)


@pytest.mark.parametrize("scale", [1e-9, 1e9])
def test_a_scale_that_runs_away_gives_the_start_back(scale):
    edge = SimilarityEdge(0, 1, np.eye(4), float(np.log(scale)), with_scale_variance(1e-4 * np.eye(6), 1e-3))
    start = np.array([np.eye(4), se3.exp(np.array([0.0, 0.1, 0.0, 1.0, 0.0, 0.0]))])
    poses, scales = optimize_sim3([edge], start, np.ones(2))
    np.testing.assert_array_equal(poses, start)
    np.testing.assert_array_equal(scales, 1.0)


def test_the_scale_may_jump_where_a_motion_was_not_measured_and_nowhere_else():
    """One camera turned away from all it knew at step 60: its unit is another one from there on."""
    logs = np.where(np.arange(COUNT) > 60, np.log(0.7), 0.0)
    guess = np.diag([4e-4] * 3 + [4e-2] * 3)
    motions = [(STEP, guess if k == 60 else MOTION_COVARIANCE) for k in range(COUNT - 1)]
    loops = [loop(TRUTH, logs, query, query - LAP) for query in range(LAP + 10, LAP + 60, 4)]
    found = estimate_log_scales(np.ones(COUNT - 1), loops, 0.01, scale_variances(motions, 0.01))
    np.testing.assert_allclose(found - found[0], logs, atol=0.03)
    without = estimate_log_scales(np.ones(COUNT - 1), loops, 0.01)
    assert np.abs(without - without[0] - logs).max() > 0.1
