"""Where the map knows a place well the graph does not grow, the camera is located, and what was wrong can be undone."""

from dataclasses import replace

import numpy as np
import pytest

from odometry import se3
from slam.loop_closing.loop_closer import LoopClosure
from slam.pose_graph.known_places import KnownPlaceConfig
from slam.pose_graph.online_loop_selection import LoopSelectionConfig
from slam.pose_graph.pose_graph import PoseGraph, PoseGraphConfig

from ..laps import LOOP_COVARIANCE, STEP_COVARIANCE, Drive, laps, loop_between, noise, settled

DRIVE = laps(side=25, laps=9.0)
LAP = 100  # frames
MAP_EVERY_PASS = PoseGraphConfig(loop_selection=LoopSelectionConfig(known_places=KnownPlaceConfig(max_passes=10**9)))


def driven(
    drive: Drive, loops: list[LoopClosure], config: PoseGraphConfig | None = None
) -> tuple[PoseGraph, np.ndarray]:
    """The graph after a drive with loops as they come, and the pose it knew at each moment (N, 4, 4)."""
    graph, known, by_query = PoseGraph(config), [np.eye(4)], {loop.query: loop for loop in loops}
    for frame, T in enumerate(drive.motions, start=1):
        graph.add_odometry(T, STEP_COVARIANCE)
        if frame in by_query:
            graph.add_loop(by_query[frame])
        known.append(graph.current_pose())
    return graph, np.array(known)


def num_nodes(graph: PoseGraph) -> int:
    """Nodes of the online graph."""
    return len(graph._nodes.node_frames)


def test_the_graph_does_not_grow_in_known_places() -> None:
    few = laps(side=25, laps=5.0)
    (after_five, _), (graph, _) = driven(few, few.loops), driven(DRIVE, DRIVE.loops)
    full, _ = driven(DRIVE, DRIVE.loops, MAP_EVERY_PASS)
    assert num_nodes(graph) <= num_nodes(after_five) + 2
    assert num_nodes(full) > 1.7 * num_nodes(graph)
    assert len(graph._incremental.used) <= len(after_five._incremental.used) + 4


def test_the_map_is_as_good_as_with_every_pass_in_it() -> None:
    (graph, known), (full, known_by_full) = driven(DRIVE, DRIVE.loops), driven(DRIVE, DRIVE.loops, MAP_EVERY_PASS)
    assert graph.poses().shape == (len(DRIVE.poses), 4, 4)
    assert DRIVE.ate(settled(graph).poses()[: len(known)]) < 1.5 * DRIVE.ate(settled(full).poses()[: len(known)])
    errors, of_full = (
        np.linalg.norm((poses - DRIVE.poses)[4 * LAP :, :3, 3], axis=1).max() for poses in (known, known_by_full)
    )
    assert errors < 1.5 * of_full


def test_every_loop_of_a_known_place_is_used_and_kept_for_the_end() -> None:
    graph, _ = driven(DRIVE, DRIVE.loops)
    used = {event.loop: event.used for event in graph.loop_events}
    assert len(graph.loops) == len(DRIVE.loops)
    assert np.mean([used[k] for k in range(len(DRIVE.loops))]) > 0.99
    assert any("knows the place well" in event.reason for event in graph.loop_events)
    full, _ = driven(DRIVE, DRIVE.loops, MAP_EVERY_PASS)
    np.testing.assert_array_equal(graph.optimize().poses, full.optimize().poses)


def test_a_street_beyond_the_known_place_is_mapped() -> None:
    straight = [se3.exp(np.array([0, 0, 0, 0, 0, 1.0]))] * 60
    poses = list(DRIVE.poses)
    for T in straight:
        poses.append(poses[-1] @ T)
    loops = [loop_between(np.random.default_rng(1), np.array(poses), 956, 952 - 2)]
    on = replace(DRIVE, poses=np.array(poses), motions=[*DRIVE.motions, *straight])
    _, known = driven(on, [*DRIVE.loops, *loops])
    np.testing.assert_allclose(se3.inverse(known[920]) @ known[940], se3.inverse(poses[920]) @ poses[940], atol=0.05)
    assert np.linalg.norm((known - on.poses)[-1, :3, 3]) < 2.0


@pytest.mark.parametrize("has_left", [False, True])
def test_what_rested_on_removed_loops_is_undone(has_left: bool) -> None:
    """A coherent false revisit of a known place: when its first loops leave, no frame stays located there."""
    graph, _ = driven(DRIVE, DRIVE.loops)
    (run,) = graph._selector._known_places._runs
    last = run.last
    if has_left:  # nodes after the run, tied by loops of their own
        for _ in range(40):
            graph.add_odometry(se3.exp(np.array([0, 0, 0, 0, 0, 1.0])), STEP_COVARIANCE)
        graph._selector._known_places.add_nodes(len(graph) - 1)
    before = num_nodes(graph)
    graph._selector._remove(run.support, "taken out: a test")
    graph._selector._state.is_settling = True
    settled(graph)
    assert graph._selector._known_places._runs == []
    if has_left:
        assert num_nodes(graph) > before + 20
    poses, odometry = graph.poses(), graph.odometry_poses()
    # What was located jumps by the noise of loops from frame to frame; nodes and those that follow them do not.
    steps, measured = (se3.inverse(T[run.first - 1 : last]) @ T[run.first : last + 1] for T in (poses, odometry))
    assert np.median(np.linalg.norm((steps - measured)[:, :3, 3], axis=1)) < 1e-3
    last_events = {event.loop: event for event in graph.loop_events}
    assert all(number in last_events for number in run.loops)


def test_false_loops_into_a_known_place_leave_when_true_ones_contradict_them() -> None:
    rng = np.random.default_rng(5)
    begin = 6 * LAP + 30
    shift = se3.exp(np.array([0, 0.01, 0, 1.5, 0, 0.8]))  # a street that looks the same, 1.7 m away
    false = []
    for query in range(begin, begin + 16, 2):
        T = (
            se3.inverse(DRIVE.poses[query - 3 * LAP])
            @ shift
            @ DRIVE.poses[query]
            @ se3.exp(noise(rng, LOOP_COVARIANCE))
        )
        false.append(LoopClosure(query, query - 3 * LAP, T, LOOP_COVARIANCE, 50))
    true = [loop for loop in DRIVE.loops if not begin - 20 <= loop.query < begin + 20]
    graph, _ = driven(DRIVE, sorted([*true, *false], key=lambda loop: loop.query))
    clean, _ = driven(DRIVE, true)
    last = {event.loop: event.used for event in graph.loop_events}
    numbers = [k for k, loop in enumerate(graph.loops) if any(loop is one for one in false)]
    assert not any(last[k] for k in numbers)
    count = len(DRIVE.poses)
    assert DRIVE.ate(settled(graph).poses()[:count]) < 1.2 * DRIVE.ate(settled(clean).poses()[:count])
