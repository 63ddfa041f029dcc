"""Poses, edges, steps and samples in the plane and in space: one set of laws for both."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slam.pose_graph.optimization.edges import Edges
from slam.pose_graph.optimization.gauss_newton import irls
from slam.pose_graph.optimization.gtsam_solver import chordal_initialization, optimize
from slam.pose_graph.optimization.lie_groups import SE2, SE3, LieGroup, Sim3, compose
from slam.pose_graph.optimization.marginals import sample_posterior

GROUPS: list[LieGroup] = [SE2(), SE3(), Sim3()]


def ring(group: LieGroup, count: int = 30, noise: float = 0.01, seed: int = 0) -> tuple[Edges, np.ndarray]:
    """A closed polygon with noisy edges all round and across; its true poses."""
    rng = np.random.default_rng(seed)
    step = np.zeros(group.dof)
    step[group.translation.start], step[group.rotation.stop - 1] = 1.0, 2 * np.pi / count
    poses = compose(np.eye(group.size), np.tile(group.exp(step[None])[0], (count - 1, 1, 1)))
    first = np.r_[np.arange(count - 1), np.arange(0, count - 10, 3)]
    second = np.r_[np.arange(1, count), np.arange(10, count, 3)]
    errors = group.exp(noise * rng.normal(size=(len(first), group.dof)))
    motions = group.inverse(poses[first]) @ poses[second] @ errors
    return Edges(first, second, motions, np.tile(np.eye(group.dof) / noise**2, (len(first), 1, 1))), poses


@pytest.mark.parametrize("group", GROUPS)
@given(seed=st.integers(0, 1000), size=st.sampled_from([0.0, 1e-9, 1e-5, 1e-4, 0.1, 1.5]))
def test_log_undoes_exp(group: LieGroup, seed: int, size: float) -> None:
    xi = size * np.random.default_rng(seed).uniform(-1, 1, size=(4, group.dof))
    np.testing.assert_allclose(group.log(group.exp(xi)), xi, atol=1e-12)


@pytest.mark.parametrize("group", GROUPS)
@given(seed=st.integers(0, 1000))
def test_the_adjoint_moves_a_perturbation_to_the_other_side(group: LieGroup, seed: int) -> None:
    rng = np.random.default_rng(seed)
    T, xi = group.exp(rng.normal(size=(3, group.dof))), rng.normal(size=(3, group.dof))
    moved = np.einsum("mij,mj->mi", group.adjoint(T), xi)
    np.testing.assert_allclose(T @ group.exp(xi), group.exp(moved) @ T, atol=1e-9)


@pytest.mark.parametrize("group", GROUPS)
def test_the_inverse_cancels(group: LieGroup) -> None:
    T = group.exp(np.random.default_rng(1).normal(size=(5, group.dof)))
    np.testing.assert_allclose(group.inverse(T) @ T, np.tile(np.eye(group.size), (5, 1, 1)), atol=1e-14)


@pytest.mark.parametrize("group", GROUPS)
def test_steps_reach_the_minimum_that_gtsam_finds(group: LieGroup) -> None:
    edges, true = ring(group)
    start = compose(true[0], edges.motions[: len(true) - 1])
    ours = irls(start, edges, lambda chi2, step: np.ones(len(chi2)))
    theirs = optimize(edges, start)
    assert edges.chi2(ours).sum() == pytest.approx(edges.chi2(theirs).sum(), rel=0.01)
    np.testing.assert_allclose(ours, theirs, atol=2e-3)
    np.testing.assert_array_equal(ours[0], start[0])


@pytest.mark.parametrize("group", GROUPS)
def test_a_weight_of_zero_removes_an_edge(group: LieGroup) -> None:
    edges, true = ring(group)
    spoilt = Edges(edges.first, edges.second, edges.motions.copy(), edges.information)
    spoilt.motions[-1] = np.eye(group.size)
    weights = np.ones(len(edges))
    weights[-1] = 0.0
    found = irls(true, spoilt, lambda chi2, step: weights)
    np.testing.assert_allclose(found, optimize(edges[:-1], true), atol=2e-3)


@pytest.mark.parametrize("group", GROUPS)
def test_samples_spread_as_the_marginals_of_a_chain(group: LieGroup) -> None:
    edges, true = ring(group)
    chain = edges[: len(true) - 1]
    ends = Edges(np.array([0]), np.array([5]), np.eye(group.size)[None], np.eye(group.dof)[None])
    expected = np.zeros((group.dof, group.dof))
    for k in range(5):
        Ad = group.adjoint(group.inverse(true[5]) @ true[k + 1])
        expected += Ad @ chain.covariance[k] @ Ad.T
    found = sample_posterior(true, chain).relative_covariance(ends)[0]
    # 48 samples: a variance is within a factor of two of the truth, ten standard errors of its logarithm apart
    ratios = np.linalg.eigvals(np.linalg.solve(expected, found)).real
    assert (ratios > 0.3).all()
    assert (ratios < 3.0).all()


@pytest.mark.parametrize("group", GROUPS)
def test_what_follows_an_edge_of_which_nothing_is_known_is_as_uncertain(group: LieGroup) -> None:
    """Hundreds of certain edges after it do not hold the poses where they are."""
    count = 300
    information = np.tile(np.eye(group.dof) * 1e8, (count, 1, 1))
    information[0] = np.eye(group.dof) / 4.0
    at, steps = np.arange(count), np.tile(np.eye(group.size), (count, 1, 1))
    chain = Edges(at, at + 1, steps, information)
    ends = Edges(np.array([0]), np.array([count]), steps[:1], information[:1])
    found = sample_posterior(compose(np.eye(group.size), steps), chain).relative_covariance(ends)[0]
    assert (np.diag(found) > 2.0).all()


@pytest.mark.parametrize("group", GROUPS[:2])  # GTSAM has none of similarities
def test_chordal_initialization_does_not_depend_on_the_start(group: LieGroup) -> None:
    edges, true = ring(group, noise=1e-3)
    lost = np.tile(np.eye(group.size), (len(true), 1, 1))
    np.testing.assert_allclose(chordal_initialization(edges, lost), true, atol=0.1)


def test_no_edge_has_no_errors() -> None:
    edges, true = ring(SE3())
    assert edges[:0].chi2(true).shape == (0,)
