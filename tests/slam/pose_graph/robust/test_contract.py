"""The contract of robust back ends: what every entry of BACK_ENDS must do."""

from dataclasses import replace

import numpy as np
import pytest

from slam.errors import GraphError
from slam.pose_graph.optimization.edges import Edges, concatenate
from slam.pose_graph.optimization.gtsam_solver import optimize
from slam.pose_graph.optimization.lie_groups import SE2, SE3, LieGroup, Sim3, compose
from slam.pose_graph.robust.backends import BACK_ENDS, LoopProblem, solve

GROUPS: dict[str, LieGroup] = {"SE(2)": SE2(), "SE(3)": SE3(), "Sim(3)": Sim3()}
ROBUST = [name for name in BACK_ENDS if name != "none"]
LAP, COUNT = 60, 120


def two_laps(group: LieGroup, seed: int = 0) -> LoopProblem:
    """Two laps of a circle with noisy odometry and ten true loops."""
    rng = np.random.default_rng(seed)
    sigmas = np.full(group.dof, 0.002)
    sigmas[group.translation] = 0.02
    step = np.zeros(group.dof)
    step[group.translation.start], step[group.rotation.stop - 1] = 1.0, 2 * np.pi / LAP
    poses = compose(np.eye(group.size), np.tile(group.exp(step[None]), (COUNT, 1, 1)))
    information = np.diag(sigmas**-2.0)

    def measure(first: np.ndarray, second: np.ndarray) -> Edges:
        noise = group.exp(rng.normal(size=(len(first), group.dof)) * sigmas)
        motions = group.inverse(poses[first]) @ poses[second] @ noise
        return Edges(first, second, motions, np.tile(information, (len(first), 1, 1)))

    trusted = measure(np.arange(COUNT), np.arange(1, COUNT + 1))
    query = np.arange(LAP + 5, COUNT, 6)
    return LoopProblem(trusted, measure(query - LAP, query), compose(np.eye(group.size), trusted.motions))


def with_gross_outlier(problem: LoopProblem) -> LoopProblem:
    """The problem with one more loop, between places half a lap apart."""
    like = problem.loops[:1]
    wrong = Edges(np.array([10]), np.array([10 + LAP // 2]), like.motions, like.information)
    return replace(problem, loops=concatenate(problem.loops, wrong))


def minimum(problem: LoopProblem) -> np.ndarray:
    return optimize(problem.edges_with(np.ones(len(problem.loops), dtype=bool)), problem.start)


@pytest.mark.parametrize("group", GROUPS)
@pytest.mark.parametrize("name", BACK_ENDS)
def test_true_loops_are_kept_and_the_poses_are_those_of_least_squares(group: str, name: str) -> None:
    problem = two_laps(GROUPS[group])
    result = solve(problem, name)
    assert result.kept.all()
    np.testing.assert_allclose(result.poses, minimum(problem), atol=0.02)


@pytest.mark.parametrize("group", GROUPS)
@pytest.mark.parametrize("name", ROBUST)
def test_a_gross_outlier_is_left_out_and_changes_nothing(group: str, name: str) -> None:
    clean = two_laps(GROUPS[group])
    result = solve(with_gross_outlier(clean), name)
    assert result.kept[:-1].all()
    assert not result.kept[-1]
    np.testing.assert_allclose(result.poses, minimum(clean), atol=0.02)
    assert "left out" in result.reasons[-1]


@pytest.mark.parametrize("group", GROUPS)
def test_least_squares_without_defence_is_ruined_by_it(group: str) -> None:
    problem = with_gross_outlier(two_laps(GROUPS[group]))
    result = solve(problem, "none")
    assert result.kept.all()
    assert np.abs(result.poses - minimum(two_laps(GROUPS[group]))).max() > 1.0


@pytest.mark.parametrize("group", GROUPS)
@pytest.mark.parametrize("name", BACK_ENDS)
def test_a_result_has_a_pose_for_every_pose_and_a_weight_and_a_reason_for_every_loop(group: str, name: str) -> None:
    problem = with_gross_outlier(two_laps(GROUPS[group]))
    result = solve(problem, name)
    assert result.poses.shape == problem.start.shape
    assert np.isfinite(result.poses).all()
    np.testing.assert_allclose(result.poses[0], problem.start[0], atol=1e-9)
    rotations = result.poses[:, :-1, :-1]
    rotations = rotations / np.cbrt(np.linalg.det(rotations))[:, None, None]  # without the scale
    identities = np.tile(np.eye(rotations.shape[1]), (len(rotations), 1, 1))
    np.testing.assert_allclose(rotations @ np.swapaxes(rotations, 1, 2), identities, atol=1e-9)
    assert result.weights.shape == (len(problem.loops),)
    assert ((result.weights >= 0) & (result.weights <= 1)).all()
    assert len(result.reasons) == len(problem.loops)
    assert all(reason and "\n" not in reason for reason in result.reasons)


@pytest.mark.parametrize("name", BACK_ENDS)
def test_without_loops_the_poses_are_those_of_odometry(name: str) -> None:
    problem = two_laps(SE2())
    result = solve(replace(problem, loops=problem.loops[:0]), name)
    np.testing.assert_array_equal(result.poses, problem.start)
    assert result.reasons == ()


@pytest.mark.parametrize("name", BACK_ENDS)
def test_the_same_problem_gives_the_same_bits(name: str) -> None:
    one, other = (solve(with_gross_outlier(two_laps(SE3())), name) for _ in range(2))
    assert one.poses.tobytes() == other.poses.tobytes()
    assert one.weights.tobytes() == other.weights.tobytes()


@pytest.mark.parametrize("name", BACK_ENDS)
def test_a_problem_is_not_changed(name: str) -> None:
    problem, same = two_laps(SE3()), two_laps(SE3())
    solve(problem, name)
    for edges, other in ((problem.trusted, same.trusted), (problem.loops, same.loops)):
        np.testing.assert_array_equal(edges.motions, other.motions)
        np.testing.assert_array_equal(edges.information, other.information)
    np.testing.assert_array_equal(problem.start, same.start)


@pytest.mark.parametrize("name", BACK_ENDS)
def test_odometry_that_falls_apart_is_one_line(name: str) -> None:
    problem = two_laps(SE2())
    broken = replace(problem, trusted=problem.trusted[np.arange(COUNT) != 70])
    with pytest.raises(GraphError, match="only 71 poses of 121 are connected to the first") as caught:
        solve(broken, name)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("edges", ["trusted", "loops"])
@pytest.mark.parametrize("name", BACK_ENDS)
def test_information_that_is_not_positive_definite_is_one_line(name: str, edges: str) -> None:
    problem = two_laps(SE3())
    information = getattr(problem, edges).information.copy()
    information[3, 0] = information[3, :, 0] = 0.0
    broken = replace(problem, **{edges: replace(getattr(problem, edges), information=information)})
    with pytest.raises(GraphError, match="expected positive definite information") as caught:
        solve(broken, name)
    assert "\n" not in str(caught.value)
