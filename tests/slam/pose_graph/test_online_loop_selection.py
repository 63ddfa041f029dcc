"""Online, no loop is used by itself, and one that proves inconsistent leaves without a trace."""

import numpy as np
import pytest

from odometry import se3
from slam.loop_closing.loop_closer import LoopClosure
from slam.pose_graph.pose_graph import PoseGraph

from ..laps import LOOP_COVARIANCE, STEP_COVARIANCE, Drive, laps, noise, settled

BIG = laps(side=150, laps=1.3, bias=(1e-4, 0.005))  # first true loop at frame 604


def drift_like(drive: Drive, query: int, match: int, sigmas: float, seed: int, count: int = 1) -> list[LoopClosure]:
    """False loops that agree with one another and that drift would explain, at a number of sigmas from odometry."""
    rng, graph = np.random.default_rng(seed), drive.graph([])
    between = graph._chain.between(match, query)
    xi = np.linalg.cholesky(between.covariance) @ rng.normal(size=6)
    xi *= sigmas / np.sqrt(xi @ np.linalg.solve(between.covariance, xi))
    measured, poses = between.T_first_second @ se3.exp(xi), graph.odometry_poses()
    out = []
    for k in range(0, 2 * count, 2):
        back, on = se3.inverse(poses[match + k]) @ poses[match], se3.inverse(poses[query]) @ poses[query + k]
        T = back @ measured @ on @ se3.exp(noise(rng, LOOP_COVARIANCE))
        out.append(LoopClosure(query + k, match + k, T, LOOP_COVARIANCE, 50))
    return out


def driven(drive: Drive, loops: list[LoopClosure], frames: int | None = None) -> tuple[PoseGraph, np.ndarray]:
    """The graph after a drive with loops as they come, and what it knew at each moment (N, 4, 4)."""
    graph, known = PoseGraph(), [np.eye(4)]
    for frame, T in enumerate(drive.motions[:frames], start=1):
        graph.add_odometry(T, STEP_COVARIANCE)
        for loop in loops:
            if loop.query == frame:
                graph.add_loop(loop)
        known.append(graph.current_pose())
    return graph, np.array(known)


@pytest.mark.parametrize("seed", range(4))
def test_a_lone_false_loop_that_passes_the_gate_moves_nothing(seed: int) -> None:
    (false,) = drift_like(BIG, 500, 120, 3.0, seed)
    graph, known = driven(BIG, [false], 560)
    assert graph.gates[0].passed
    np.testing.assert_allclose(known, graph.odometry_poses(), atol=1e-9)
    assert "no other loop of this stretch agrees yet" in graph.loop_events[0].reason


def test_lone_false_loops_among_true_ones_never_enter() -> None:
    rng = np.random.default_rng(3)
    lone = [drift_like(BIG, int(q), int(q) - 300, 4.0, int(q))[0] for q in rng.integers(400, 700, 8)]
    clean, _ = driven(BIG, BIG.loops)
    mixed, _ = driven(BIG, [*BIG.loops, *lone])
    used = {change.loop for change in mixed.loop_events if change.used}
    assert not any(mixed.loops[k] in lone for k in used)
    np.testing.assert_allclose(settled(mixed).poses(), settled(clean).poses(), atol=0.05)


def test_two_true_loops_of_one_stretch_are_used() -> None:
    graph, _ = driven(BIG, BIG.loops[:2])
    first, *_, last = graph.loop_events
    assert not first.used
    assert last.used
    frame = BIG.loops[1].query
    before = np.linalg.norm((graph.odometry_poses() - BIG.poses[: len(graph)])[frame, :3, 3])
    assert np.linalg.norm((graph.poses() - BIG.poses[: len(graph)])[frame, :3, 3]) < 0.2 * before


def test_two_loops_of_one_stretch_that_contradict_each_other_both_stay_out() -> None:
    (one,), (other,) = (drift_like(BIG, 500 + k, 120 + k, 3.0, seed) for k, seed in ((0, 1), (4, 2)))
    graph, known = driven(BIG, [one, other], 560)
    assert not any(change.used for change in graph.loop_events)
    np.testing.assert_allclose(known, graph.odometry_poses(), atol=1e-9)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_false_loops_that_agree_leave_when_true_ones_contradict_them(seed: int) -> None:
    false = drift_like(BIG, 480, 100, 4.5, seed, count=3)
    clean, _ = driven(BIG, BIG.loops)
    graph, _ = driven(BIG, [*false, *BIG.loops])
    at_first = {change.loop for change in graph.loop_events if change.used and change.frame < 600}
    assert at_first == {0, 1, 2}
    assert BIG.ate(settled(graph).poses()[: len(BIG.poses)]) < 1.2 * BIG.ate(settled(clean).poses()[: len(BIG.poses)])
    for loop in range(3):
        last = [change for change in graph.loop_events if change.loop == loop][-1]
        assert not last.used
        assert "taken out" in last.reason


def test_a_removed_loop_leaves_no_trace() -> None:
    graph, never = PoseGraph(), PoseGraph()
    for g in (graph, never):
        for T in BIG.motions[:620]:
            g.add_odometry(T, STEP_COVARIANCE)
        for loop in BIG.loops[:6]:
            g.add_loop(loop)
        settled(g)
    false = drift_like(BIG, 480, 100, 4.5, 0)[0]
    between_nodes = graph._nodes.between_nodes(graph.config.with_noise_floor(false))
    assert between_nodes is not None
    graph._incremental.add_loops({99: between_nodes})
    while not graph._incremental.step():
        pass
    assert np.abs(graph.poses() - never.poses()).max() > 0.5
    graph._incremental.remove_loops([99])
    while not graph._incremental.step():
        pass
    np.testing.assert_allclose(graph.poses()[:, :3, 3], never.poses()[:, :3, 3], atol=0.02)


def test_every_change_is_logged_once_and_in_order() -> None:
    graph, _ = driven(BIG, [*drift_like(BIG, 480, 100, 4.5, 0, count=3), *BIG.loops])
    frames = [change.frame for change in graph.loop_events]
    assert frames == sorted(frames)
    assert {change.loop for change in graph.loop_events} == set(range(len(graph.loops)))
    assert all(change.reason for change in graph.loop_events)


def test_two_runs_give_the_same_bits() -> None:
    loops = [*drift_like(BIG, 480, 100, 4.5, 0, count=3), *BIG.loops]
    (one, known), (two, again) = driven(BIG, loops), driven(BIG, loops)
    assert known.tobytes() == again.tobytes()
    assert one.loop_events == two.loop_events
