"""A route driven many times: the batch decides on a smaller graph, and its result is that of the whole one."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sparse
from scipy.sparse.linalg import SuperLU

from slam.pose_graph import pose_graph
from slam.pose_graph.optimization import gauss_newton
from slam.pose_graph.optimization.edges import Edges, concatenate
from slam.pose_graph.optimization.gauss_newton import factorize_jacobian
from slam.pose_graph.optimization.gtsam_solver import optimize
from slam.pose_graph.optimization.lie_groups import SE2, SE3, LieGroup, compose, inverse
from slam.pose_graph.optimization.marginals import marginals_by_factors
from slam.pose_graph.robust import pcm, problem
from slam.pose_graph.robust.backends import BACK_ENDS, DEFAULT, LoopProblem, solve
from slam.pose_graph.robust.covariance_calibration import screen
from slam.pose_graph.robust.problem import OnlineMap, condense, condensed_covariances

from ...laps import laps

LAP, LAPS = 60, 20
COUNT = LAP * LAPS
MAX_POSES = 300
PARTS = (slice(0, 3), slice(3, 6))  # rotation and position of a covariance


@pytest.fixture
def few_poses(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every graph of more than `MAX_POSES` poses is a long one."""
    monkeypatch.setattr(problem, "MAX_POSES", MAX_POSES)


def sigmas_of(group: LieGroup) -> np.ndarray:
    sigmas = np.full(group.dof, 0.02)
    sigmas[group.rotation] = 0.002
    return sigmas


def route(group: LieGroup) -> np.ndarray:
    """True poses of a circle that is driven `LAPS` times."""
    step = np.zeros(group.dof)
    step[group.translation.start], step[group.rotation.stop - 1] = 1.0, 2 * np.pi / LAP
    return compose(np.eye(group.size), np.tile(group.exp(step[None]), (COUNT - 1, 1, 1)))


def measure(poses: np.ndarray, group: LieGroup, first: np.ndarray, second: np.ndarray, seed: int) -> Edges:
    sigmas = sigmas_of(group)
    noise = group.exp(np.random.default_rng(seed).normal(size=(len(first), group.dof)) * sigmas)
    information = np.tile(np.diag(sigmas**-2.0), (len(first), 1, 1))
    return Edges(first, second, inverse(poses[first]) @ poses[second] @ noise, information)


def long_drive(group: LieGroup) -> LoopProblem:
    """Every frame of every later lap has a loop, to the first lap or to the one before."""
    poses, query = route(group), np.arange(LAP, COUNT)
    match = np.where(query % 3 == 0, query - LAP, query % LAP)
    trusted = measure(poses, group, np.arange(COUNT - 1), np.arange(1, COUNT), 0)
    return LoopProblem(trusted, measure(poses, group, match, query, 1), compose(np.eye(group.size), trusted.motions))


def with_false(clean: LoopProblem) -> LoopProblem:
    """The drive with lone false loops, and with a run of them that agree with one another."""
    rng, group = np.random.default_rng(5), clean.loops.group
    query = rng.integers(4 * LAP, COUNT, 40)
    match = (rng.random(40) * (query - LAP)).astype(np.int64)
    lone = measure(route(group), group, match, query, 2)
    lone = replace(lone, motions=group.exp(rng.normal(size=(40, group.dof))))
    poses, run = route(group), np.arange(8)
    agreeing = measure(poses, group, LAP // 2 + run, 10 * LAP + run, 3)
    there, wrong = poses[10 * LAP + run], group.exp(np.full((1, group.dof), 0.5))
    agreeing = replace(agreeing, motions=agreeing.motions @ inverse(there) @ wrong @ there)
    return replace(clean, loops=concatenate(clean.loops, concatenate(lone, agreeing)))


@pytest.mark.parametrize("group", [SE2(), SE3()])
@pytest.mark.usefixtures("few_poses")
def test_false_loops_are_left_out_and_the_poses_are_those_of_the_true_ones(group: LieGroup) -> None:
    clean, truth = long_drive(group), route(group)
    whole = with_false(clean)
    result = solve(whole)
    best = optimize(clean.edges_with(np.ones(len(clean.loops), bool)), clean.start)
    error = np.linalg.norm((best - truth)[:, :-1, -1], axis=1).mean()
    odometry_error = np.linalg.norm((clean.start - truth)[:, :-1, -1], axis=1).mean()
    difference = np.linalg.norm((result.poses - best)[:, :-1, -1], axis=1).mean()
    assert len(screen(whole).condensed.rows) <= MAX_POSES < COUNT
    assert error < 0.2 * odometry_error
    assert difference < 0.02 * error
    assert result.kept[: len(clean.loops)].mean() > 0.995
    assert not result.kept[len(clean.loops) :].any()


@pytest.mark.parametrize("name", [name for name in BACK_ENDS if name not in ("none", DEFAULT)])
@pytest.mark.usefixtures("few_poses")
def test_every_robust_back_end_decides_on_the_smaller_graph(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    clean, truth, sizes = long_drive(SE2()), route(SE2()), []

    def count(jacobian: sparse.csr_array) -> SuperLU:
        sizes.append(jacobian.shape[1] // 3 + 1)
        return factorize_jacobian(jacobian)

    monkeypatch.setattr(gauss_newton, "factorize_jacobian", count)
    result = solve(with_false(clean), name)
    error, odometry_error = (
        np.linalg.norm((poses - truth)[:, :-1, -1], axis=1).mean() for poses in (result.poses, clean.start)
    )
    assert max(sizes, default=0) <= MAX_POSES
    assert error < 0.3 * odometry_error
    assert not result.kept[len(clean.loops) :].any()


@pytest.mark.usefixtures("few_poses")
def test_a_small_error_that_hides_in_the_smaller_graph_is_found_in_the_whole_one() -> None:
    clean = long_drive(SE2())
    motions = clean.loops.motions.copy()
    motions[505, 0, 2] += 0.25
    kept = solve(replace(clean, loops=replace(clean.loops, motions=motions))).kept
    assert not kept[505]
    assert np.delete(kept, 505).mean() > 0.995


@pytest.mark.usefixtures("few_poses")
def test_loops_that_agree_far_better_than_stated_do_not_forbid_the_drift_of_odometry() -> None:
    """As on a drive whose later laps have the same images: loops without errors, odometry with the same ones."""
    clean, group = long_drive(SE2()), SE2()
    poses, loops = route(group), clean.loops
    exact = replace(loops, motions=inverse(poses[loops.first]) @ poses[loops.second])
    drift = group.exp(np.random.default_rng(7).normal(size=(LAP, group.dof)) * 3.0 * sigmas_of(group))
    steps = inverse(poses[:-1]) @ poses[1:] @ drift[np.arange(COUNT - 1) % LAP]
    drive = LoopProblem(replace(clean.trusted, motions=steps), exact, compose(np.eye(group.size), steps))
    assert solve(drive).kept.mean() > 0.995


@pytest.mark.usefixtures("few_poses")
def test_a_long_drive_whose_odometry_turns_over_is_decided_from_the_online_map() -> None:
    """An error that each lap repeats rolls the camera over twice: hardly a loop agrees with odometry."""
    clean, poses = long_drive(SE3()), route(SE3())
    roll = SE3().exp(np.array([[0.0, 0.0, 4.0 * np.pi / COUNT, 0.0, 0.0, 0.0]]))[0]
    trusted = replace(clean.trusted, motions=clean.trusted.motions @ roll)
    drive = replace(with_false(clean), trusted=trusted, start=compose(np.eye(4), trusted.motions))
    is_true = np.arange(len(drive.loops)) < len(clean.loops)
    used = is_true & (np.arange(len(is_true)) % 5 > 0)
    used[len(clean.loops) + 3] = True  # the online map may use a false loop
    result = solve(replace(drive, online=OnlineMap(poses, used)), DEFAULT)
    assert result.kept[is_true].mean() > 0.99
    assert not result.kept[~is_true].any()
    assert np.linalg.norm(result.poses[:, :3, 3] - poses[:, :3, 3], axis=1).max() < 1.0
    assert solve(drive, DEFAULT).kept[is_true].mean() < 0.5  # the control: from odometry


@pytest.mark.parametrize("group", [SE2(), SE3()])
@pytest.mark.usefixtures("few_poses")
def test_a_loop_that_agrees_with_odometry_agrees_wherever_its_ends_are_moved(group: LieGroup) -> None:
    drive = long_drive(group)
    exact = inverse(drive.start[drive.loops.first]) @ drive.start[drive.loops.second]
    whole = replace(drive, loops=replace(drive.loops, motions=exact))
    small = condense(whole)
    assert not small.is_exact
    assert len(small.rows) < COUNT / 9
    np.testing.assert_allclose(small.problem.loops.chi2(small.problem.start), 0.0, atol=1e-9)
    assert (np.abs(small.rows[small.problem.loops.second] - drive.loops.second) <= 5).all()


@pytest.mark.parametrize("group", [SE2(), SE3()])
@pytest.mark.usefixtures("few_poses")
def test_a_moved_loop_is_as_uncertain_as_the_loop_and_odometry_together(group: LieGroup) -> None:
    """Errors of simulated steps and loops, moved, have the stated covariance."""
    drive, poses, chi2 = long_drive(group), route(group), []
    rows = np.arange(COUNT - 1)
    loops = slice(507, 512)  # all of one stretch, moved by different ways
    for seed in range(150):
        trusted = measure(poses, group, rows, rows + 1, 10 + seed)
        measured = measure(poses, group, drive.loops.first, drive.loops.second, 1000 + seed)
        small = condense(LoopProblem(trusted, measured, compose(np.eye(group.size), trusted.motions)))
        moved = small.problem.loops[loops]
        chi2.append(moved.chi2(poses[small.rows]) / group.dof)
    np.testing.assert_allclose(np.mean(chi2, axis=0), 1.0, atol=0.25)


def test_a_graph_that_is_not_long_stays_as_it_was() -> None:
    drive = long_drive(SE2())
    assert condense(drive).problem is drive
    assert condense(drive).is_exact


def test_the_poses_of_the_smaller_graph_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(problem, "MAX_POSES", 50)
    assert len(condense(long_drive(SE2())).rows) <= 51


@pytest.mark.usefixtures("few_poses")
def test_the_pairs_of_the_consistency_do_not_grow_with_the_square_of_the_loops(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(pcm, "SEEDS", 20)
    monkeypatch.setattr(pcm, "_MAX_PAIRS", 2000)
    monkeypatch.setattr(pcm, "_MIN_TESTED_SEEDS", 2)
    drive = long_drive(SE2())
    likelihood = screen(drive).likelihood
    largest, inner = [0], pcm._cycle

    def count(posterior: object, loops: Edges, a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        largest.append(len(a))
        return inner(posterior, loops, a, b)  # type: ignore[arg-type]

    def pairs(loops: int) -> int:
        largest.clear()
        rows = np.linspace(0, len(drive.loops) - 1, loops).astype(np.int64)
        accepted = pcm.pairwise_consistent(likelihood, rows, 4.0)
        assert len(accepted) > 0.9 * loops
        return sum(largest)

    monkeypatch.setattr(pcm, "_cycle", count)
    few, many = pairs(280), pairs(1120)
    assert few <= 20**2 + 2000
    assert many <= 20**2 + 2 * 1120


def every_lap_with_every_other() -> LoopProblem:
    """The drive in space with loops to any lap before, which join all laps with one another."""
    rng, drive, query = np.random.default_rng(3), long_drive(SE3()), np.arange(LAP, COUNT)
    match = query - LAP * rng.integers(1, query // LAP + 1)
    return replace(drive, loops=measure(route(SE3()), SE3(), match, query, 1))


def test_poses_stay_as_close_as_the_fill_of_the_factors_allows(
    few_poses: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(problem, "_MIN_MOVED_POSES", 30)
    drive = every_lap_with_every_other()
    sizes = [len(condense(drive, blocks).rows) for blocks in (100_000, 3000, 0)]
    assert sizes == [121, 61, 31]
    fill = [problem._count_factor_blocks(drive.loops, np.arange(0, COUNT, spacing)) for spacing in (10, 20)]
    assert fill[0] > 3000 > fill[1]


@pytest.mark.usefixtures("few_poses")
def test_a_few_steps_solve_the_whole_drive_once_rigid_motions_of_places_are_taken_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    drive, all_loops = every_lap_with_every_other(), np.ones(COUNT - LAP, dtype=bool)
    jacobian = gauss_newton.whitened_jacobian(route(SE3()), drive.edges_with(all_loops))[:, 6:]
    right = np.random.default_rng(0).normal(size=jacobian.shape[1])
    modes = condense(drive).place_modes(all_loops, route(SE3()))
    assert modes.shape[1] <= 6 * LAP // 5
    exact = gauss_newton.solve_by_factors(jacobian, right, 6)
    monkeypatch.setattr(gauss_newton, "_MAX_CG_STEPS", 40)
    with_places = gauss_newton.conjugate_gradients(modes)(jacobian, right, 6)
    without = gauss_newton.conjugate_gradients(modes[:, :0])(jacobian, right, 6)
    size = np.linalg.norm(exact)
    assert np.linalg.norm(with_places - exact) < 1e-3 * size
    assert np.linalg.norm(without - exact) > 1e-2 * size


def sigma_ratios(drive: LoopProblem, bias: np.ndarray, percentiles: list[float]) -> np.ndarray:
    """Standard deviations (P, 2) of a long drive over those of all its poses, rotation and position, in percentiles.

    With a bias (6, 6) of each step, those by the bias alone.
    """
    errors = np.tile(bias, (COUNT - 1, 1, 1))
    edges, of_edges = concatenate(drive.trusted, drive.loops), np.zeros((COUNT - 1 + len(drive.loops), 6, 6))
    full = marginals_by_factors(drive.start, edges, of_edges)
    short = condensed_covariances(drive, 0.0 * errors)
    if bias.any():
        of_edges[: COUNT - 1] = bias
        full = marginals_by_factors(drive.start, edges, of_edges) - full
        short = condensed_covariances(drive, errors) - short
    parts = [np.trace(short[1:, p, p], axis1=1, axis2=2) / np.trace(full[1:, p, p], axis1=1, axis2=2) for p in PARTS]
    return np.sqrt(np.percentile(parts, percentiles, axis=1))


def some_loops(every: int) -> LoopProblem:
    """The drive in space at its true poses, with the loop of every so many frames."""
    drive = long_drive(SE3())
    return LoopProblem(drive.trusted, drive.loops[np.arange(0, len(drive.loops), every)], route(SE3()))


@pytest.mark.parametrize(("every", "low", "high"), [(1, 1.0, 1.28), (2, 0.95, 1.15), (COUNT, 0.999, 1.002)])
@pytest.mark.usefixtures("few_poses")
def test_covariances_of_a_long_drive_are_nearly_those_of_all_its_poses(every: int, low: float, high: float) -> None:
    ratios = sigma_ratios(some_loops(every), np.zeros((6, 6)), [5, 50, 95])
    assert ratios.min() > low
    assert ratios.max() < high
    np.testing.assert_allclose(ratios[1], 1.0, atol=0.12)


@pytest.mark.parametrize("every", [1, 2, 10, COUNT])
@pytest.mark.usefixtures("few_poses")
def test_a_bias_of_odometry_shifts_a_long_drive_as_it_shifts_all_its_poses(every: int) -> None:
    ratios = sigma_ratios(some_loops(every), np.diag([1e-5] * 3 + [1e-3] * 3), [5, 50, 95])
    np.testing.assert_allclose(ratios[1], 1.0, atol=0.02)


def test_a_pose_graph_takes_the_covariances_of_a_long_drive(monkeypatch: pytest.MonkeyPatch) -> None:
    drive = laps(laps=6)
    graph = drive.graph()
    result = graph.optimize()
    full = graph.covariances(result)
    monkeypatch.setattr(pose_graph, "_MAX_GTSAM_POSES", 60)
    np.testing.assert_allclose(graph.covariances(result)[1:], full[1:], rtol=0.05, atol=5e-4)
    monkeypatch.setattr(problem, "MAX_POSES", 60)
    short = graph.covariances(result)
    ratios = [
        np.sqrt(np.trace(short[1:, p, p], axis1=1, axis2=2) / np.trace(full[1:, p, p], axis1=1, axis2=2)) for p in PARTS
    ]
    assert (np.abs(np.percentile(ratios, [5, 50, 95], axis=1) - 1.0) < [[0.1], [0.03], [0.12]]).all()
    assert not np.array_equal(short, full)
