"""The pose graph: what loops put right, what false ones must not spoil."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from odometry import se3
from slam.errors import ConfigError, GraphError
from slam.io.g2o import chain_graph, read_g2o, write_g2o
from slam.loop_closing.loop_closer import LoopClosure
from slam.pose_graph.isam2 import IncrementalConfig
from slam.pose_graph.loop_clusters import LoopClusterConfig
from slam.pose_graph.node_chain import NodeSpacing
from slam.pose_graph.odometry_chain import OdometryDriftModel
from slam.pose_graph.online_loop_selection import LoopSelectionConfig
from slam.pose_graph.pose_graph import PoseGraph, PoseGraphConfig
from slam.pose_graph.robust import backends as back_ends
from slam.pose_graph.robust.backends import BACK_ENDS

from ..laps import LOOP_COVARIANCE, STEP_COVARIANCE, Drive, false_loops, laps, loop_between, settled

CREDULOUS = LoopSelectionConfig(1e9, 1e9, LoopClusterConfig(max_agreement_chi2=1e9))
PLAIN = PoseGraphConfig(
    nodes=NodeSpacing(min_distance_m=0.0),
    incremental=IncrementalConfig(huber_width_sigma=1e6, relinearize_threshold=1e-6),
    loop_selection=CREDULOUS,
)


@pytest.fixture(scope="module")
def drive() -> Drive:
    return laps()


def test_one_loop_at_the_end_of_a_square_takes_most_of_the_error(drive: Drive) -> None:
    square = laps(laps=1.05)
    graph = square.graph(square.loops[:1])
    before, after = square.ate(graph.odometry_poses()), square.ate(graph.optimize("none").poses)
    assert after < 0.5 * before


@pytest.mark.parametrize("name", BACK_ENDS)
def test_true_loops_correct_the_trajectory_with_every_back_end(drive: Drive, name: str) -> None:
    result = drive.graph().optimize(name)
    assert result.kept.all()
    assert drive.ate(result.poses) < 0.25 * drive.ate(drive.graph([]).odometry_poses())
    assert result.error_final < result.error_initial


@pytest.mark.parametrize("name", BACK_ENDS)
def test_without_loops_the_answer_is_odometry(drive: Drive, name: str) -> None:
    graph = drive.graph([])
    result = graph.optimize(name)
    np.testing.assert_array_equal(result.poses, graph.odometry_poses())
    assert result.kept.shape == result.weights.shape == result.residuals.shape == (0,)
    assert result.reasons == ()


@pytest.mark.parametrize("name", BACK_ENDS)
def test_a_perfect_trajectory_stays_as_it_is(name: str) -> None:
    drive = laps(laps=1.2)
    motions = list(se3.inverse(drive.poses[:-1]) @ drive.poses[1:])
    exact = LoopClosure(104, 4, se3.inverse(drive.poses[4]) @ drive.poses[104], LOOP_COVARIANCE, 50)
    result = Drive(drive.poses, motions, [exact]).graph().optimize(name)
    np.testing.assert_allclose(result.poses, drive.poses, atol=1e-6)
    assert result.residuals[0] < 1e-3


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5])
@pytest.mark.parametrize("seed", [1, 2])
def test_false_loops_do_not_spoil_gnc(share: float, seed: int) -> None:
    drive, rng = laps(seed=seed), np.random.default_rng(seed)
    count = round(len(drive.loops) * share / (1 - share))
    loops = [*drive.loops, *false_loops(rng, len(drive.poses), count)]
    result = drive.graph(loops).optimize("gnc")
    clean = drive.ate(drive.graph().optimize("none").poses)
    assert drive.ate(result.poses) <= 1.1 * clean
    assert not result.kept[len(drive.loops) :].any()
    assert all("left out" in reason for reason in result.reasons[len(drive.loops) :])


def test_the_order_of_loops_changes_no_decision(drive: Drive) -> None:
    loops = [*drive.loops[:20], *false_loops(np.random.default_rng(3), len(drive.poses), 10)]
    order = np.random.default_rng(4).permutation(len(loops))
    straight = drive.graph(loops).optimize("gnc")
    shuffled = drive.graph([loops[k] for k in order]).optimize("gnc")
    np.testing.assert_array_equal(shuffled.kept, straight.kept[order])
    np.testing.assert_allclose(shuffled.poses, straight.poses, atol=1e-3)


def test_where_all_loops_are_false_gnc_leaves_odometry(drive: Drive) -> None:
    first_lap = Drive(drive.poses[:80], drive.motions[:79], [])
    graph = first_lap.graph(false_loops(np.random.default_rng(5), 80, 12))
    result = graph.optimize("gnc")
    if result.kept.any():
        pytest.fail(f"kept {result.reasons}")
    np.testing.assert_array_equal(result.poses, graph.odometry_poses())
    assert (result.weights == 0).all()


@pytest.mark.parametrize("bias", [(0.0, 0.01), (1e-4, 0.02), (-1.5e-4, 0.03), (1e-4, -0.03)])
def test_true_loops_pass_the_gate_after_drift(bias: tuple[float, float]) -> None:
    drive = laps(side=150, laps=1.1, bias=bias)
    assert all(drive.graph().gates[k].passed for k in range(len(drive.loops)))


def test_errors_that_each_lap_repeats_do_not_shut_the_gate() -> None:
    drive, lap = laps(laps=40.0), 100
    rng = np.random.default_rng(0)
    errors = [se3.exp(rng.normal(size=6) * np.repeat([1.5e-3, 0.01], 3)) for _ in range(lap)]
    steps = se3.inverse(drive.poses[:-1]) @ drive.poses[1:]
    graph = PoseGraph()
    for query, step in enumerate(steps, start=1):
        graph.add_odometry(step @ errors[query % lap], STEP_COVARIANCE)
        if query > lap + 4:
            graph.add_loop(loop_between(rng, drive.poses, query, query % lap))
    late = graph.gates[-lap:]
    assert all(gate.passed for gate in late)
    assert drive.ate(graph.poses()) < 1.0
    true = loop_between(rng, drive.poses, len(drive.poses) - 1, 0)
    by_odometry = graph._chain.between(true.match, true.query)
    assert not graph._compare(true, by_odometry).passed  # by odometry alone no drift explains it any more
    wrong = replace(true, T_match_query=true.T_match_query @ se3.exp(np.array([0, 0, 0, 15.0, 0, 0])))
    assert not graph._gate(wrong).passed


def test_the_batch_of_a_long_drive_begins_with_the_map_made_online(
    drive: Drive, monkeypatch: pytest.MonkeyPatch
) -> None:
    graph, problems = drive.graph(), []
    solve = back_ends.solve
    monkeypatch.setattr(back_ends, "solve", lambda problem, name: problems.append(problem) or solve(problem, name))
    graph.optimize()
    np.testing.assert_array_equal(problems[0].online.poses, graph.poses())
    used = [graph._selector.is_used(number) for number in range(len(graph.loops))]
    assert problems[0].online.used.tolist() == used
    assert sum(used) > len(used) / 2


def test_a_loop_from_the_wrong_street_fails_the_gate() -> None:
    drive = laps(side=150, laps=1.0, bias=(1e-4, 0.01))
    graph = drive.graph([])
    wrong = graph.add_loop(LoopClosure(430, 150, np.eye(4), LOOP_COVARIANCE, 30))
    assert not wrong.passed
    assert wrong.residual > np.sqrt(graph.config.max_gate_chi2)
    assert "drift does not explain" in wrong.reason
    assert len(graph.loops) == len(graph.gates) == 1
    np.testing.assert_allclose(graph.poses(), graph.odometry_poses(), atol=1e-6)


def test_online_is_batch_where_nothing_is_robust(drive: Drive) -> None:
    graph = drive.graph(config=PLAIN)
    online, batch = settled(graph).poses(), graph.optimize("none").poses
    np.testing.assert_allclose(online[:, :3, 3], batch[:, :3, 3], atol=0.01)
    np.testing.assert_allclose(graph.current_pose(), online[-1], atol=1e-9)


def test_online_estimates_follow_the_trajectory(drive: Drive) -> None:
    graph, loops, errors = PoseGraph(), {loop.query: loop for loop in drive.loops}, []
    for frame, T in enumerate(drive.motions, start=1):
        graph.add_odometry(T, STEP_COVARIANCE)
        if frame in loops:
            graph.add_loop(loops[frame])
        errors.append(np.linalg.norm((graph.current_pose() - drive.poses[frame])[:3, 3]))
    assert max(errors[110:]) < 0.5 * max(errors[:104])
    assert drive.ate(graph.poses()) < 1.3 * drive.ate(graph.optimize("none").poses)


def test_a_frame_that_follows_a_loop_continues_from_the_corrected_pose(drive: Drive) -> None:
    graph = drive.graph()
    before = graph.current_pose()
    graph.add_odometry(drive.motions[0], STEP_COVARIANCE)
    np.testing.assert_allclose(graph.current_pose(), before @ drive.motions[0], atol=1e-6)


@pytest.mark.parametrize("name", BACK_ENDS)
def test_two_runs_give_the_same_bits(drive: Drive, name: str) -> None:
    loops = [*drive.loops, *false_loops(np.random.default_rng(6), len(drive.poses), 20)]
    one, two = drive.graph(loops), drive.graph(loops)
    assert one.poses().tobytes() == two.poses().tobytes()
    assert one.optimize(name).poses.tobytes() == two.optimize(name).poses.tobytes()


def test_a_new_graph_holds_one_pose() -> None:
    graph = PoseGraph()
    assert len(graph) == 1
    np.testing.assert_array_equal(graph.current_pose(), np.eye(4))
    np.testing.assert_allclose(graph.poses(), np.eye(4)[None], atol=1e-12)
    np.testing.assert_array_equal(graph.optimize().poses, np.eye(4)[None])


def test_an_unknown_back_end_is_named_with_the_known_ones(drive: Drive) -> None:
    with pytest.raises(ConfigError, match="'hubert': expected one of none, huber, dcs, switchable, gnc, pcm, pcm"):
        drive.graph().optimize("hubert")


def test_a_loop_to_a_missing_frame_is_an_error() -> None:
    with pytest.raises(GraphError, match=r"loop 5 -> 0: expected .* among the 1 in the graph"):
        PoseGraph().add_loop(LoopClosure(5, 0, np.eye(4), LOOP_COVARIANCE, 30))


@pytest.mark.parametrize("bad", [np.zeros((6, 6)), np.full((6, 6), np.nan), np.eye(3), -np.eye(6)])
def test_an_invalid_covariance_is_an_error(bad: np.ndarray) -> None:
    with pytest.raises(GraphError, match="motion to frame 1: expected a finite, positive definite covariance"):
        PoseGraph().add_odometry(np.eye(4), bad)


def test_a_graph_can_be_written_and_read(drive: Drive, tmp_path: Path) -> None:
    graph = drive.graph()
    write_g2o(tmp_path / "a.g2o", chain_graph(graph.odometry_poses(), graph.odometry, graph.loops))
    back = read_g2o(tmp_path / "a.g2o")
    assert len(back.ids) == len(graph)
    assert len(back.motions) == len(graph) - 1 + len(drive.loops)
    np.testing.assert_allclose(back.information[0], np.linalg.inv(STEP_COVARIANCE), rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize(("name", "minimum"), [("parking-garage", 0.634192), ("smallGrid3D", 517.925)])
def test_standard_graphs_reach_their_known_minimum(test_data: Path, name: str, minimum: float) -> None:
    file = read_g2o(test_data / "pose_graphs" / f"{name}.g2o")
    exact = OdometryDriftModel(sigma_m_per_m=0.0, sigma_rad_per_m=0.0)
    graph = PoseGraph(PoseGraphConfig(drift=exact, loop_sigma_rad=0.0, loop_sigma_m=0.0))
    covariances = np.linalg.inv(file.information)
    chain = {int(i): k for k, i in enumerate(file.first) if file.second[k] == i + 1}
    for i in range(len(file.ids) - 1):
        graph.add_odometry(file.motions[chain[i]], covariances[chain[i]])
    for k in sorted(set(range(len(file.first))) - set(chain.values())):
        ends, T = (int(file.first[k]), int(file.second[k])), file.motions[k]
        T, C = (T, covariances[k]) if ends[0] < ends[1] else reversed_edge(T, covariances[k])
        graph.add_loop(LoopClosure(max(ends), min(ends), T, C, 0))
    assert graph.optimize("none").error_final == pytest.approx(minimum, rel=1e-4)


def reversed_edge(T: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    Ad = se3.adjoint(T)
    return se3.inverse(T), Ad @ covariance @ Ad.T
