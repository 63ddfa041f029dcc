"""How loops speak for and against one another: votes of neighbours, company, contests, the tails of errors."""

from dataclasses import replace

import numpy as np
import pytest

from slam.pose_graph_batch import minimum, refined
from slam.pose_graph_edges import Edges
from slam.pose_graph_lie import SE2, compose, inverse
from slam.robust_contest import opponents
from slam.robust_evidence import evidence, freedom_of
from slam.robust_pcm import agreement, in_company, outvoted
from slam.robust_problem import LoopProblem

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
def test_a_false_loop_that_drift_explains_is_outvoted_by_those_next_to_it(seed: int) -> None:
    problem = laps({30: 1.5}, seed)
    found = evidence(problem.start, problem.trusted, problem.loops)
    rows = np.arange(len(problem.loops))
    assert found.at(1.0)[30] > 0.0
    np.testing.assert_array_equal(outvoted(found, rows, 1.0), [30])
    assert not len(outvoted(found, rows[30:31], 1.0))


def test_what_two_loops_miss_the_map_by_is_no_quarrel_between_them() -> None:
    problem = laps({10: 0.4, 60: -0.4})
    every = np.ones(len(problem.loops), dtype=bool)
    every[[10, 60]] = False
    poses = minimum(problem.using(every), problem.start)
    found = evidence(poses, problem.using(every), problem.loops)
    assert (found.chi2[[10, 60]] > 40.0).all()
    assert agreement(found, np.array([10]), np.array([60]), 1.0).all()
    by_odometry = evidence(problem.start, problem.trusted, problem.loops)
    assert not agreement(by_odometry, np.array([10]), np.array([11]), 1.0).any()


def test_company_counts_from_afar_only() -> None:
    problem = laps({77: 4.0})
    found = evidence(problem.start, problem.trusted, problem.loops)
    together = in_company(found, np.array([0, 2, 70, 77]), 1.0)
    alone = found.at(1.0)[[0, 2, 70, 77]]
    assert (together[:3] > alone[:3] + 3.0).all()
    assert together[3] < together[2] - 3.0
    assert np.isneginf(in_company(found, np.arange(20), 1.0)).all()


def test_a_loop_that_was_left_out_names_the_false_one_in_its_place() -> None:
    problem = laps({40: 1.5})
    kept = np.isin(np.arange(len(problem.loops)), [5, 40])
    poses = minimum(problem.using(kept), problem.start)
    against = opponents(problem, poses, kept, np.array([41, 42]), 21.0)
    np.testing.assert_array_equal(np.flatnonzero(against), [40])
    assert not opponents(problem, poses, kept, np.array([4]), 21.0).any()


def test_the_tails_of_errors_are_found() -> None:
    rng = np.random.default_rng(3)
    gaussian = rng.chisquare(3, 3000)
    heavy = gaussian / (rng.chisquare(5, 3000) / 5)
    assert freedom_of(gaussian, 3) >= 40.0
    assert freedom_of(heavy, 3) == 5.0
    assert freedom_of(7.0 * gaussian, 3) == freedom_of(gaussian, 3)


def test_the_better_start_is_taken() -> None:
    problem = laps({})
    edges = problem.using(np.ones(len(problem.loops), dtype=bool))
    best = edges.chi2(refined(edges, problem.start)).sum()
    lost = replace(problem, start=np.tile(np.eye(3), (len(problem.start), 1, 1))).start
    assert edges.chi2(minimum(edges, lost)).sum() == pytest.approx(best, rel=1e-4)
