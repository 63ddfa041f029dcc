"""How loops support and contradict one another: votes of neighbours, pairs, conflicts, the tails of errors."""

from dataclasses import replace

import numpy as np
import pytest

from slam.pose_graph.optimization.edges import Edges
from slam.pose_graph.optimization.gtsam_solver import optimize, refine
from slam.pose_graph.optimization.lie_groups import SE2, compose, inverse
from slam.pose_graph.robust.consensus import conflicting_loops
from slam.pose_graph.robust.likelihood_ratio import estimate_student_dof, loop_likelihood
from slam.pose_graph.robust.pcm import best_pair_log_ratio, contradicted_by_neighbors, pairwise_consistency
from slam.pose_graph.robust.problem import LoopProblem

GROUP, LAP, SIDE = SE2(), 160, 40
SIGMA = np.array([0.03, 0.03, 0.003])


def laps(wrong: dict[int, float], seed: int = 0) -> LoopProblem:
    """Twice round a block; of the loops of lap two some are metres off sideways."""
    rng, count = np.random.default_rng(seed), 2 * LAP
    turning = np.arange(count) % SIDE >= SIDE - 8
    steps = GROUP.exp(np.column_stack([np.ones(count), np.zeros(count), np.where(turning, np.pi / 16, 0.0)]))
    poses, rows, query = compose(np.eye(3), steps), np.arange(count), np.arange(LAP + 4, count, 2)
    odometry = steps @ GROUP.exp(rng.normal(size=(count, 3)) * SIGMA)
    loops = inverse(poses[query - LAP]) @ poses[query] @ GROUP.exp(rng.normal(size=(len(query), 3)) * SIGMA)
    for k, metres in wrong.items():
        loops[k, 1, 2] += metres
    information = np.diag(SIGMA**-2)
    trusted = Edges(rows, rows + 1, odometry, np.tile(information, (count, 1, 1)))
    edges = Edges(query - LAP, query, loops, np.tile(information, (len(query), 1, 1)))
    return LoopProblem(trusted, edges, compose(np.eye(3), odometry))


@pytest.mark.parametrize("seed", range(5))
def test_a_false_loop_that_drift_explains_is_contradicted_by_its_neighbors(seed: int) -> None:
    problem = laps({30: 1.5}, seed)
    likelihood = loop_likelihood(problem.start, problem.trusted, problem.loops)
    rows = np.arange(len(problem.loops))
    assert likelihood.log_ratio_at(1.0)[30] > 0.0
    np.testing.assert_array_equal(contradicted_by_neighbors(likelihood, rows, 1.0), [30])
    assert not len(contradicted_by_neighbors(likelihood, rows[30:31], 1.0))


def test_two_loops_far_from_the_map_need_not_contradict_each_other() -> None:
    problem = laps({10: 0.4, 60: -0.4})
    every = np.ones(len(problem.loops), dtype=bool)
    every[[10, 60]] = False
    poses = optimize(problem.edges_with(every), problem.start)
    likelihood = loop_likelihood(poses, problem.edges_with(every), problem.loops)
    assert (likelihood.chi2[[10, 60]] > 40.0).all()
    assert pairwise_consistency(likelihood, np.array([10]), np.array([60]), 1.0).all()
    by_odometry = loop_likelihood(problem.start, problem.trusted, problem.loops)
    assert not pairwise_consistency(by_odometry, np.array([10]), np.array([11]), 1.0).any()


def test_a_pair_counts_only_if_its_loops_are_far_apart() -> None:
    problem = laps({77: 4.0})
    likelihood, images = loop_likelihood(problem.start, problem.trusted, problem.loops), np.arange(len(problem.start))
    together = best_pair_log_ratio(likelihood, np.array([0, 2, 70, 77]), 1.0, images)
    log_ratio_at_fit = likelihood.log_ratio_at(1.0)[[0, 2, 70, 77]]
    assert (together[:3] > log_ratio_at_fit[:3] + 3.0).all()
    assert together[3] < together[2] - 3.0
    assert np.isneginf(best_pair_log_ratio(likelihood, np.arange(20), 1.0, images)).all()
    # The same loops in a recording of ten times as many images, of which the graph has one in ten.
    assert np.isfinite(best_pair_log_ratio(likelihood, np.arange(20), 1.0, 10 * images)).all()


def test_a_left_out_loop_identifies_the_false_loop_that_excludes_it() -> None:
    problem = laps({40: 1.5})
    kept = np.isin(np.arange(len(problem.loops)), [5, 40])
    poses = optimize(problem.edges_with(kept), problem.start)
    against = conflicting_loops(problem, poses, kept, np.array([41, 42]), 21.0)
    np.testing.assert_array_equal(np.flatnonzero(against), [40])
    assert not conflicting_loops(problem, poses, kept, np.array([4]), 21.0).any()


def test_the_heavy_tail_of_errors_is_estimated() -> None:
    rng = np.random.default_rng(3)
    gaussian = rng.chisquare(3, 3000)
    heavy = gaussian / (rng.chisquare(5, 3000) / 5)
    assert estimate_student_dof(gaussian, 3) >= 40.0
    assert estimate_student_dof(heavy, 3) == 5.0
    assert estimate_student_dof(7.0 * gaussian, 3) == estimate_student_dof(gaussian, 3)


def test_the_better_start_is_taken() -> None:
    problem = laps({})
    edges = problem.edges_with(np.ones(len(problem.loops), dtype=bool))
    best = edges.chi2(refine(edges, problem.start)).sum()
    lost = replace(problem, start=np.tile(np.eye(3), (len(problem.start), 1, 1))).start
    assert edges.chi2(optimize(edges, lost)).sum() == pytest.approx(best, rel=1e-4)


def test_a_prediction_wider_than_the_map_says_nothing_for_or_against_a_loop() -> None:
    problem = laps({})
    likelihood = loop_likelihood(problem.start, problem.trusted, problem.loops)
    widths = np.array([-20.0, 0.0, 50.0, 200.0])  # log-determinants of the covariance
    centres = likelihood.log_ratio(np.zeros(4), widths, 1.0)
    assert centres[0] > centres[1] > 0.0
    np.testing.assert_allclose(centres[2:], 0.0, atol=1e-9)
    assert (likelihood.log_ratio(np.full(4, 9.0), widths, 1.0) < centres - 1.0).all()
