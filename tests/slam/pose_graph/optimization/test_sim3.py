"""Scale that drifts is found by loops that compare units, and taken out with the drift of the poses."""

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from odometry import se3
from slam.evaluation.trajectory_errors import absolute_trajectory_error
from slam.loop_closing.loop_closer import LoopClosure
from slam.loop_closing.relative_pose import ScaleRatio
from slam.pose_graph.odometry_chain import OdometryDriftModel, chain_motions
from slam.pose_graph.optimization.edges import Edges, concatenate
from slam.pose_graph.optimization.gtsam_solver import refine
from slam.pose_graph.optimization.lie_groups import Sim3, rigid_and_scale, similarities
from slam.pose_graph.optimization.sim3 import scale_variances, similarity_loops, similarity_motions
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


def graph_of(logs, loops, scale_drift=0.01, covariances=None):
    """Two laps whose motions have covariances other than the usual one at some steps."""
    graph = PoseGraph(PoseGraphConfig(drift=OdometryDriftModel(sigma_m_per_m=0.03), scale_drift=scale_drift))
    for k in range(COUNT - 1):
        covariance = (covariances or {}).get(k, MOTION_COVARIANCE)
        graph.add_odometry(between(TRUTH, np.exp(logs), k, k + 1), covariance)
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
    level = np.zeros(COUNT)
    plain = [loop(TRUTH, level, query, query - LAP, sigma=0.0) for query in range(LAP, COUNT, 20)]
    np.testing.assert_allclose(graph_of(level, plain).optimize().scales, 1.0, atol=1e-6)


def test_a_loop_with_a_false_scale_among_true_ones_is_left_out(drifting):
    true = [loop(TRUTH, drifting, query, query - LAP) for query in range(LAP, COUNT, 4)]
    false = loop(TRUTH, np.where(np.arange(COUNT) == 161, drifting + 1.0, drifting), 161, 61)
    result = graph_of(drifting, [*true, false]).optimize()
    assert result.kept.tolist() == [True] * len(true) + [False]
    np.testing.assert_allclose(result.scales, graph_of(drifting, true).optimize().scales, rtol=0.01)


def test_drift_between_loops_is_spread_evenly(drifting):
    motions = [(between(TRUTH, np.exp(drifting), k, k + 1), 1e4 * np.eye(6)) for k in range(COUNT - 1)]
    chain = similarity_motions(motions, np.full(COUNT - 1, 1e-4))
    edges = concatenate(chain, similarity_loops([loop(TRUTH, drifting, COUNT - 1, 0, 1e-4)]))
    found = refine(edges, chain_motions([T for T, _ in motions]))
    np.testing.assert_allclose(np.log(rigid_and_scale(found)[1]), drifting, atol=1e-3)


def test_the_scale_may_jump_where_a_motion_was_not_measured_and_nowhere_else():
    """One camera turned away from all it knew at step 60: its unit is another one from there on."""
    logs = np.where(np.arange(COUNT) > 60, np.log(0.7), 0.0)
    loops = [loop(TRUTH, logs, query, query - LAP) for query in range(LAP + 10, LAP + 60, 4)]
    guess = {60: np.diag([4e-4] * 3 + [4e-2] * 3)}
    found = graph_of(logs, loops, covariances=guess).optimize()
    assert found.kept.all()
    np.testing.assert_allclose(np.log(found.scales), logs, atol=0.03)
    without = graph_of(logs, loops).optimize("none")
    assert np.abs(np.log(without.scales) - logs).max() > 0.1


def test_loops_are_kept_where_nothing_was_measured_for_so_long_that_odometry_says_nothing():
    """Odometry loses the camera, by two radians and thirty metres, which is more than the map is wide.

    Any loop across that stretch is as likely as any other by odometry, but a long run of loops agrees.
    """
    count, lost = 3 * LAP, range(140, 160)
    truth, level = chain_motions([STEP] * (count - 1)), np.zeros(count)
    graph = PoseGraph(PoseGraphConfig(drift=OdometryDriftModel(sigma_m_per_m=0.03), scale_drift=0.01))
    wrong = se3.exp(np.array([0.1, 0.3, -0.2, 8.0, 2.0, 5.0]))
    for k in range(count - 1):
        T = STEP @ wrong if k == 150 else STEP
        graph.add_odometry(T, np.diag([0.2] * 3 + [50.0] * 3) if k in lost else MOTION_COVARIANCE)
    for query in range(160, count, 2):
        graph.add_loop(loop(truth, level, query, query - 160))
    result = graph.optimize()
    assert result.kept.all()
    assert absolute_trajectory_error(graph.odometry_poses(), truth, "sim3") > 3.0
    assert absolute_trajectory_error(result.poses, truth, "sim3") < 1.0


def test_the_scale_changes_by_a_share_of_the_error_of_a_length_in_any_unit():
    def variance(step, sigma, drift=0.0):
        motion = se3.exp(np.array([0.0, 0.1, 0.0, 0.0, 0.0, step]))
        return float(scale_variances([(motion, np.diag([1e-7] * 3 + [sigma**2] * 3))], drift)[0])

    assert variance(3.0, 0.03) == pytest.approx(variance(1.0, 0.01))
    assert variance(0.1, 0.01) == pytest.approx(100 * variance(1.0, 0.01))
    assert variance(0.002, 0.02) == variance(1.0, 1.0) == 0.25  # no more than where a motion was not measured
    assert variance(1.0, 0.01, drift=0.01) == pytest.approx(variance(1.0, 0.01) + 1e-4, rel=1e-3)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_the_group_is_that_of_matrix_exponentials_and_of_gtsam(seed):
    rng = np.random.default_rng(seed)
    xi = rng.normal(0, [0.8] * 3 + [2.0] * 3 + [0.7])
    T = Sim3().exp(xi[None])[0]
    generator = np.zeros((4, 4))
    generator[:3, :3], generator[:3, 3] = se3.skew(xi[:3]) + xi[6] * np.eye(3), xi[3:6]
    np.testing.assert_allclose(T, expm(generator), rtol=1e-9, atol=1e-9)
    theirs = gtsam.Similarity3.Expmap(xi)
    np.testing.assert_allclose(T[:3, :3], theirs.scale() * theirs.rotation().matrix(), atol=1e-6)
    np.testing.assert_allclose(T[:3, 3], theirs.scale() * theirs.translation(), atol=1e-6)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_exact_similarities_are_found_from_a_wrong_start(seed):
    """Gauge: the first node is held, whatever it is, and all others follow."""
    rng = np.random.default_rng(seed)
    poses = np.array([se3.exp(rng.normal(0, [0.4] * 3 + [2.0] * 3)) for _ in range(6)])
    logs = rng.normal(0, 0.3, 6)
    motions = [(between(poses, np.exp(logs), k, k + 1), np.eye(6) * 1e-2) for k in range(5)]
    chain = similarity_motions(motions, np.full(5, 0.01))
    chain.motions[:] = similarities(chain.motions, np.exp(np.diff(logs)))
    loops = similarity_loops([loop(poses, logs, 3, 0), loop(poses, logs, 5, 1)])
    edges = concatenate(chain, loops)
    truth = similarities(poses, np.exp(logs))
    np.testing.assert_allclose(edges.errors(truth), 0.0, atol=1e-9)
    noise = np.concatenate([np.zeros((1, 7)), rng.normal(0, 0.1, (5, 7))])
    found = refine(edges, truth @ Sim3().exp(noise))
    np.testing.assert_allclose(found, truth, atol=1e-4)


@pytest.mark.parametrize("scale", [1e-9, 1e9])
def test_a_scale_that_runs_away_gives_the_start_back(scale):
    motion = similarities(np.eye(4)[None], np.array([scale]))
    information = np.diag([1e4] * 6 + [1e6])[None]
    start = np.array([np.eye(4), se3.exp(np.array([0.0, 0.1, 0.0, 1.0, 0.0, 0.0]))])
    found = refine(Edges(np.array([0]), np.array([1]), motion, information), start)
    np.testing.assert_array_equal(found, start)
    np.testing.assert_allclose(rigid_and_scale(found)[1], 1.0)
