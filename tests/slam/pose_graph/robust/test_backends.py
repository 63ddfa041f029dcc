"""Back ends under false loops: what they must keep, what they must leave out, and what must not matter."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from slam.errors import ConfigError
from slam.evaluation.outlier_injection import KINDS, OutlierConfig, inject_outliers
from slam.evaluation.pose_graph_errors import absolute_error, find_truth
from slam.io.g2o import read_g2o
from slam.io.g2o_problem import classify_edges
from slam.pose_graph.optimization.edges import Edges
from slam.pose_graph.optimization.gtsam_solver import optimize
from slam.pose_graph.optimization.lie_groups import SE2, SE3, LieGroup, compose, inverse
from slam.pose_graph.robust.backends import BACK_ENDS, LoopProblem, dcs, huber, solve, switchable
from slam.pose_graph.robust.gnc import gnc_tls_weights
from slam.pose_graph.robust.pcm import greedy_max_weight_clique

GROUPS = {"plane": SE2(), "space": SE3()}


def laps(group: LieGroup, laps: float = 2.0, side: int = 40, seed: int = 0) -> LoopProblem:
    """Drive round a square block, a metre a step, with honest noise; every second step of later laps closes a loop."""
    rng, lap = np.random.default_rng(seed), 4 * side
    count = int(laps * lap)
    sigma = np.full(group.dof, 0.03)
    sigma[group.rotation] = 0.003
    steps = np.zeros((count, group.dof))
    steps[:, group.translation.start] = 1.0
    steps[np.arange(count) % side >= side - 8, group.rotation.stop - 1] = np.pi / 16
    poses = compose(np.eye(group.size), group.exp(steps))
    information = np.diag(sigma**-2.0)
    rows = np.arange(count)
    trusted = measured(rng, group, poses, np.column_stack([rows, rows + 1]), information)
    query = np.arange(lap + 4, count, 2)
    loops = measured(rng, group, poses, np.column_stack([query - lap, query]), information)
    return LoopProblem(trusted, loops, compose(np.eye(group.size), trusted.motions))


def measured(
    rng: np.random.Generator, group: LieGroup, poses: np.ndarray, ends: np.ndarray, information: np.ndarray
) -> Edges:
    noise = rng.normal(size=(len(ends), group.dof)) / np.sqrt(np.diag(information))
    motions = inverse(poses[ends[:, 0]]) @ poses[ends[:, 1]] @ group.exp(noise)
    return Edges(ends[:, 0], ends[:, 1], motions, np.tile(information, (len(ends), 1, 1)))


def everything(problem: LoopProblem) -> Edges:
    return problem.edges_with(np.ones(len(problem.loops), dtype=bool))


def scaled(edges: Edges, factor: float) -> Edges:
    return replace(edges, information=edges.information / factor)


@pytest.mark.parametrize("group", GROUPS)
@pytest.mark.parametrize("name", BACK_ENDS)
def test_without_false_loops_every_back_end_keeps_the_true_ones(group: str, name: str) -> None:
    problem = laps(GROUPS[group])
    outcome = solve(problem, name)
    best = everything(problem).chi2(optimize(everything(problem), problem.start)).sum()
    assert outcome.kept.mean() >= 0.98
    assert everything(problem).chi2(outcome.poses).sum() <= 1.05 * best


@pytest.mark.parametrize("group", GROUPS)
@pytest.mark.parametrize(("kind", "share"), [("random", 0.7), ("grouped", 0.5), ("coherent", 0.5)])
def test_the_default_back_end_rejects_false_loops_of_every_kind(group: str, kind: str, share: float) -> None:
    problem = laps(GROUPS[group])
    clean = everything(problem)
    best = optimize(clean, problem.start)
    mixed = inject_outliers(problem, best, OutlierConfig(kind, share, seed=3))
    outcome = solve(mixed.problem)
    assert clean.chi2(outcome.poses).sum() <= 1.05 * clean.chi2(best).sum()
    assert outcome.kept[mixed.true].mean() >= 0.98
    assert not outcome.kept[~mixed.true].any()
    assert all(reason.startswith("left out") for reason in np.array(outcome.reasons)[~mixed.true])


@pytest.mark.parametrize("factor", [1 / 16, 16.0])
def test_scaling_every_covariance_changes_no_decision(factor: float) -> None:
    problem = laps(SE2())
    mixed = inject_outliers(problem, problem.start, OutlierConfig("coherent", 0.4)).problem
    other = LoopProblem(scaled(mixed.trusted, factor), scaled(mixed.loops, factor), mixed.start)
    np.testing.assert_array_equal(solve(mixed).kept, solve(other).kept)


def test_where_every_loop_is_false_odometry_stays() -> None:
    problem = laps(SE2(), laps=1.0)
    donors = laps(SE2())
    loops = donors.loops[:20]
    rng = np.random.default_rng(2)
    first = rng.integers(0, 60, 20)
    loops = Edges(first, first + rng.integers(40, 90, 20), loops.motions, loops.information)
    outcome = solve(replace(problem, loops=loops))
    assert not outcome.kept.any()
    np.testing.assert_array_equal(outcome.poses, problem.start)


def test_one_true_loop_is_found_among_a_hundred_false_ones() -> None:
    problem = laps(SE2(), laps=1.5)
    alone = replace(problem, loops=problem.loops[20:21])
    mixed = inject_outliers(alone, problem.start, OutlierConfig("grouped", 100 / 101, seed=1))
    outcome = solve(mixed.problem)
    assert outcome.kept[mixed.true].all()
    assert not outcome.kept[~mixed.true].any()


def test_the_order_of_loops_changes_no_decision() -> None:
    problem = laps(SE2())
    mixed = inject_outliers(problem, problem.start, OutlierConfig("random", 0.5)).problem
    order = np.random.default_rng(4).permutation(len(mixed.loops))
    shuffled = solve(replace(mixed, loops=mixed.loops[order]))
    np.testing.assert_array_equal(shuffled.kept, solve(mixed).kept[order])


@pytest.mark.parametrize("name", BACK_ENDS)
def test_two_runs_give_the_same_bits(name: str) -> None:
    mixed = inject_outliers(laps(SE3(), side=20), laps(SE3(), side=20).start, OutlierConfig("random", 0.3)).problem
    assert solve(mixed, name).poses.tobytes() == solve(mixed, name).poses.tobytes()


@pytest.mark.parametrize("kernel", [huber, dcs, switchable])
def test_kernels_have_weight_one_at_zero_and_fall(kernel: object) -> None:
    weights = kernel(np.array([0.0, 1.0, 10.0, 1e3, 1e6]), 10.0)  # type: ignore[operator]
    assert weights[0] == 1.0
    assert (np.diff(weights) <= 0).all()
    assert weights[-1] < 0.01


def test_truncated_squares_become_binary_as_they_harden() -> None:
    chi2 = np.array([0.1, 9.0, 11.0, 1e4])
    np.testing.assert_allclose(gnc_tls_weights(chi2, 10.0, 1e6), [1, 1, 0, 0], atol=1e-3)
    assert (gnc_tls_weights(chi2[:3], 10.0, 0.5) > 0.2).all()


def test_many_true_loops_outweigh_a_clique_of_false_ones() -> None:
    agree = np.zeros((8, 8), dtype=bool)
    agree[:5, :5] = agree[5:, 5:] = True
    np.testing.assert_array_equal(greedy_max_weight_clique(agree, np.ones(8)), np.arange(5))
    np.testing.assert_array_equal(greedy_max_weight_clique(agree, np.r_[np.ones(5), 2 * np.ones(3)]), [5, 6, 7])


@pytest.mark.parametrize("kind", KINDS)
def test_false_loops_are_as_many_as_asked_and_lie_apart(kind: str) -> None:
    problem = laps(SE2())
    mixed = inject_outliers(problem, problem.start, OutlierConfig(kind, 0.6))
    assert (~mixed.true).mean() == pytest.approx(0.6, abs=0.01)
    false = mixed.problem.loops[~mixed.true]
    assert (false.second - false.first >= 20).all()
    assert false.second.max() < len(problem.start)


def test_an_unknown_kind_of_false_loop_is_an_error() -> None:
    with pytest.raises(ConfigError, match="expected one of random, grouped, coherent and a share"):
        inject_outliers(laps(SE2()), laps(SE2()).start, OutlierConfig("sneaky"))


@pytest.mark.parametrize(("sequence", "best"), [("00", 2.04), ("02", 5.24), ("05", 2.60)])
def test_real_false_loops_do_no_harm(test_data: Path, sequence: str, best: float) -> None:
    path = test_data / "pose_graphs" / "kitti_real_loops" / f"kitti_{sequence}_alpha_0.15.g2o"
    graph = read_g2o(path)
    sorted_ = classify_edges(graph, path.name)
    truth = find_truth(path, graph, sorted_.trusted, test_data / "kitti_poses")
    assert truth.loops is not None
    outcome = solve(sorted_.problem)
    ate = absolute_error(outcome.poses, truth.positions)
    assert ate is not None
    assert ate <= 1.02 * best
    assert not outcome.kept[~truth.loops].any()
    assert outcome.kept[truth.loops].mean() >= 0.98


@pytest.mark.parametrize(
    ("name", "least"), [("CSAIL", 20.275), ("intel", 22.502), ("manhattan", 1774.52), ("smallGrid3D", 517.925)]
)
def test_standard_graphs_reach_their_minimum_from_odometry(test_data: Path, name: str, least: float) -> None:
    problem = classify_edges(read_g2o(test_data / "pose_graphs" / f"{name}.g2o"), name).problem
    poses = optimize(everything(problem), problem.start)
    assert 0.5 * everything(problem).chi2(poses).sum() == pytest.approx(least, rel=1e-3)


@pytest.mark.parametrize("group", GROUPS)
def test_odometry_without_noise_but_with_a_bias_keeps_its_loops(group: str) -> None:
    problem = laps(GROUPS[group])
    move = GROUPS[group]
    steps = np.zeros((len(problem.trusted), move.dof))
    steps[:, move.translation.start] = 1.002
    steps[np.arange(len(steps)) % 40 >= 32, move.rotation.stop - 1] = np.pi / 16 + 1e-4
    trusted = replace(problem.trusted, motions=move.exp(steps))
    outcome = solve(LoopProblem(trusted, problem.loops, compose(np.eye(move.size), trusted.motions)))
    assert outcome.kept.mean() >= 0.98
