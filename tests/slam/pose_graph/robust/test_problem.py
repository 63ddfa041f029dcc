"""A condensed chain: the same errors, and the same poses after expansion."""

from dataclasses import replace

import numpy as np
import pytest

from slam.pose_graph.optimization.edges import Edges
from slam.pose_graph.optimization.gtsam_solver import optimize
from slam.pose_graph.optimization.lie_groups import SE2, SE3, LieGroup, compose, inverse
from slam.pose_graph.robust.problem import LoopProblem, condense


def drive(group: LieGroup, count: int = 95) -> LoopProblem:
    rng = np.random.default_rng(7)
    sigmas = rng.uniform(0.01, 0.03, group.dof)
    steps = np.zeros((count, group.dof))
    steps[:, group.translation.start], steps[:, group.rotation.stop - 1] = 1.0, 2 * np.pi / count
    motions = group.exp(steps + 0.1 * sigmas * rng.normal(size=(count, group.dof)))
    rows = np.arange(count)
    information = np.tile(np.diag(sigmas**-2.0), (count, 1, 1))
    trusted = Edges(rows, rows + 1, motions, information)
    start = compose(np.eye(group.size), motions)
    ends = np.array([[0, count], [3, count - 8]])
    moved = group.exp(0.02 * rng.normal(size=(2, group.dof)))
    measured = inverse(start[ends[:, 0]]) @ start[ends[:, 1]] @ moved
    return LoopProblem(trusted, Edges(ends[:, 0], ends[:, 1], measured, information[:2]), start)


@pytest.mark.parametrize("group", [SE2(), SE3()])
def test_the_smallest_error_and_the_poses_are_those_of_the_whole_graph(group: LieGroup) -> None:
    whole = drive(group)
    small = condense(whole)
    every = np.ones(2, dtype=bool)
    poses = optimize(whole.edges_with(every), whole.start)
    fewer = optimize(small.problem.edges_with(every), small.problem.start)
    assert len(fewer) < 20
    assert small.problem.edges_with(every).chi2(fewer).sum() == pytest.approx(
        whole.edges_with(every).chi2(poses).sum(), rel=0.01
    )
    np.testing.assert_allclose(fewer, poses[small.rows], atol=2e-3)
    np.testing.assert_allclose(small.expand(fewer), poses, atol=0.01)


@pytest.mark.parametrize("group", [SE2(), SE3()])
def test_errors_of_loops_and_the_start_are_unchanged(group: LieGroup) -> None:
    whole = drive(group)
    small = condense(whole)
    np.testing.assert_allclose(small.problem.loops.chi2(small.problem.start), whole.loops.chi2(whole.start))
    np.testing.assert_allclose(small.problem.trusted.chi2(small.problem.start), 0.0, atol=1e-9)
    np.testing.assert_allclose(small.expand(small.problem.start), whole.start, atol=1e-9)


def test_edges_that_form_no_chain_stay_as_they_are() -> None:
    whole = drive(SE2())
    backwards = replace(whole.trusted, first=whole.trusted.second, second=whole.trusted.first)
    other = replace(whole, trusted=backwards)
    assert condense(other).problem is other
