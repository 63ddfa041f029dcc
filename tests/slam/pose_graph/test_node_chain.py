"""Frames are attached to nodes, and loops move to the nodes without a change of what they measure."""

from dataclasses import replace

import numpy as np
import pytest

from odometry import se3
from slam.pose_graph.node_chain import NodeChain, NodeSpacing
from slam.pose_graph.odometry_chain import OdometryChain, OdometryDriftModel

from ..laps import LOOP_COVARIANCE, STEP_COVARIANCE, laps, loop_between

NO_TURN = 1e9  # radians: turning makes no node


def chained(motions: list[np.ndarray], spacing: NodeSpacing) -> tuple[NodeChain, OdometryChain]:
    """Frames of some motions, none of them attached but the first."""
    chain = OdometryChain(OdometryDriftModel(0.0, 0.0))
    nodes = NodeChain(chain, spacing)
    for T in motions:
        chain.append(T, STEP_COVARIANCE)
        nodes.append()
    return nodes, chain


def attach_all(nodes: NodeChain) -> np.ndarray:
    """T_world_node (K, 4, 4) of all nodes, where odometry puts them."""
    T_world_nodes = [np.eye(4)]
    for node in nodes.attach(len(nodes) - 1):
        assert node.number == len(T_world_nodes)
        T_world_nodes.append(T_world_nodes[node.previous.node] @ node.previous.T_node_frame)
    return np.array(T_world_nodes)


def filled(spacing: NodeSpacing) -> tuple[NodeChain, OdometryChain, np.ndarray]:
    """Nodes and chain of a noisy lap, and T_world_node of each node."""
    nodes, chain = chained(laps(laps=1.0).motions, spacing)
    return nodes, chain, attach_all(nodes)


@pytest.mark.parametrize("min_distance_m", [0.0, 2.5, 10.0, 1000.0])
def test_frames_on_unmoved_nodes_lie_where_odometry_puts_them(min_distance_m: float) -> None:
    nodes, chain, T_world_nodes = filled(NodeSpacing(min_distance_m, NO_TURN))
    np.testing.assert_allclose(nodes.poses(T_world_nodes), chain.poses, atol=1e-9)


def test_frames_that_are_not_attached_follow_by_odometry() -> None:
    nodes, chain = chained(laps(laps=1.0).motions, NodeSpacing())
    nodes.attach(20)
    moved = se3.exp(np.array([0.1, 0.2, 0.0, 1.0, 2.0, 3.0]))
    T_world_nodes = moved @ chain.poses[nodes.node_frames]
    assert nodes.num_attached == 21
    np.testing.assert_allclose(nodes.poses(T_world_nodes), moved @ chain.poses, atol=1e-9)


def test_a_frame_becomes_a_node_after_a_distance_or_after_turning_on_the_spot() -> None:
    forward, turn = se3.exp(np.array([0, 0, 0, 0, 0, 1.0])), se3.exp(np.array([0, 0.2, 0, 0, 0, 0]))
    nodes, _ = chained([forward] * 6 + [turn] * 6, NodeSpacing(min_distance_m=2.5, min_angle_rad=0.5))
    attach_all(nodes)
    assert nodes.node_frames.tolist() == [0, 3, 6, 9, 12]


def test_standing_still_makes_no_nodes() -> None:
    nodes, _ = chained([np.eye(4)] * 50, NodeSpacing())
    assert nodes.attach(50) == []
    assert nodes[50].node == 0


def test_located_frames_lie_on_their_node_and_later_ones_follow_them() -> None:
    nodes, chain = chained(laps(laps=1.0).motions, NodeSpacing())
    nodes.attach(40)
    T_world_nodes, there = chain.poses[nodes.node_frames], se3.exp(np.array([0, 0.1, 0, 1.0, 0, 0]))
    nodes.locate(3, np.array([np.eye(4), there]), 0.01 * np.eye(6))
    assert nodes.num_attached == 43
    poses = nodes.poses(T_world_nodes)
    np.testing.assert_allclose(poses[42], T_world_nodes[3] @ there, atol=1e-12)
    np.testing.assert_allclose(se3.inverse(poses[42]) @ poses[60], se3.inverse(chain[42]) @ chain[60], atol=1e-12)
    np.testing.assert_allclose(poses[:41], chain.poses[:41], atol=1e-9)
    assert nodes[60].node == 3
    since = chain.between_without_bias(42, 60)
    expected = se3.compose_covariance(0.01 * np.eye(6), since.T_first_second, since.covariance)
    np.testing.assert_allclose(nodes[60].covariance, expected, atol=1e-12)


@pytest.mark.parametrize("num_located", [1, 2, 3, 4])
def test_frames_that_are_attached_after_located_ones_follow_these(num_located: int) -> None:
    nodes, chain = chained(laps(laps=1.0).motions, NodeSpacing())
    nodes.attach(40)
    T_world_nodes, last = list(chain.poses[nodes.node_frames]), 40 + num_located
    there = se3.exp(np.array([0, 0.1, 0, 1.0, 0, 0]))
    nodes.locate(3, np.tile(there, (num_located, 1, 1)), 0.01 * np.eye(6))
    for node in nodes.attach(60):
        T_world_nodes.append(T_world_nodes[node.previous.node] @ node.previous.T_node_frame)
    poses = nodes.poses(np.array(T_world_nodes))
    expected = T_world_nodes[3] @ there @ se3.inverse(chain[last]) @ chain.poses[last:61]
    np.testing.assert_allclose(poses[last:61], expected, atol=1e-9)


@pytest.mark.parametrize("is_past", [False, True])
def test_located_frames_can_be_given_back_to_odometry(is_past: bool) -> None:
    nodes, chain = chained(laps(laps=1.0).motions, NodeSpacing())
    nodes.attach(40)
    nodes.locate(3, np.tile(np.eye(4), (12, 1, 1)), np.eye(6))
    T_world_nodes = list(chain.poses[nodes.node_frames])
    if is_past:
        for node in nodes.attach(80):
            T_world_nodes.append(T_world_nodes[node.previous.node] @ node.previous.T_node_frame)
        made, after = nodes.insert_nodes(41, 52)
        assert after is not None
        for node in made:
            T_world_nodes.append(T_world_nodes[node.previous.node] @ node.previous.T_node_frame)
        assert len(made) > 2
        assert nodes.node_frames[after.number] > 52
        np.testing.assert_allclose(
            T_world_nodes[after.previous.node] @ after.previous.T_node_frame,
            chain[int(nodes.node_frames[after.number])],
            atol=1e-9,
        )
    else:
        nodes.detach(41)
    np.testing.assert_allclose(nodes.poses(np.array(T_world_nodes))[:53], chain.poses[:53], atol=1e-9)


@pytest.mark.parametrize("is_located_again", [False, True])
def test_located_frames_are_given_back_where_no_node_of_its_own_follows(is_located_again: bool) -> None:
    nodes, chain = chained(laps(laps=1.0).motions, NodeSpacing(3.5, NO_TURN))
    nodes.attach(40)
    nodes.locate(3, np.tile(np.eye(4), (12, 1, 1)), np.eye(6))
    T_world_nodes = list(chain.poses[nodes.node_frames])
    assert nodes.attach(53) == []  # too near to the last located frame
    if is_located_again:
        nodes.locate(4, np.tile(np.eye(4), (6, 1, 1)), np.eye(6))
    made, after = nodes.insert_nodes(41, 52)
    assert after is None
    for node in made:
        T_world_nodes.append(T_world_nodes[node.previous.node] @ node.previous.T_node_frame)
    poses = nodes.poses(np.array(T_world_nodes))
    np.testing.assert_allclose(poses[:54], chain.poses[:54], atol=1e-9)
    if is_located_again:
        np.testing.assert_allclose(poses[54:60], np.tile(T_world_nodes[4], (6, 1, 1)), atol=1e-12)


def test_a_frame_has_the_covariance_of_the_chain_from_its_node() -> None:
    nodes, chain, _ = filled(NodeSpacing(10.0, NO_TURN))
    first = next(k for k in range(1, 100) if nodes[k].node == 3)
    np.testing.assert_allclose(nodes[first + 6].covariance, chain.between(first, first + 6).covariance, atol=1e-12)


def test_a_loop_between_nodes_measures_the_same_as_the_loop_between_frames() -> None:
    drive = laps()
    true = se3.inverse(drive.poses[:-1]) @ drive.poses[1:]
    nodes, _ = chained(list(true), NodeSpacing(min_distance_m=4.5))
    T_world_nodes = attach_all(nodes)
    loop = loop_between(np.random.default_rng(0), drive.poses, 113, 12)
    between_nodes = nodes.between_nodes(loop)
    assert between_nodes is not None
    T_match_query = se3.inverse(T_world_nodes[between_nodes.match]) @ T_world_nodes[between_nodes.query]
    own = se3.inverse(loop.T_match_query) @ se3.inverse(drive.poses[12]) @ drive.poses[113]
    moved = se3.inverse(between_nodes.T_match_query) @ T_match_query
    assert se3.angle(own) == pytest.approx(se3.angle(moved), abs=1e-9)
    assert np.linalg.eigvalsh(between_nodes.covariance - 0.99 * LOOP_COVARIANCE.min() * np.eye(6)).min() > 0


def test_the_covariance_of_a_moved_loop_is_that_of_random_trials() -> None:
    rng, (nodes, *_) = np.random.default_rng(2), filled(NodeSpacing(min_distance_m=8.5))
    loop = loop_between(rng, laps().poses, 75, 15)
    between_nodes, match, query = nodes.between_nodes(loop), nodes[15], nodes[75]
    assert between_nodes is not None
    errors = []
    for _ in range(1500):
        noisy = [
            T @ se3.exp(np.linalg.cholesky(C + 1e-18 * np.eye(6)) @ rng.normal(size=6))
            for T, C in (
                (match.T_node_frame, match.covariance),
                (loop.T_match_query, loop.covariance),
                (query.T_node_frame, query.covariance),
            )
        ]
        errors.append(se3.log(se3.inverse(between_nodes.T_match_query) @ noisy[0] @ noisy[1] @ se3.inverse(noisy[2])))
    nees = np.einsum("ni,ij,nj->n", errors, np.linalg.inv(between_nodes.covariance), errors)
    assert nees.mean() == pytest.approx(6.0, abs=0.4)


def test_a_loop_within_one_node_cannot_be_moved_to_nodes() -> None:
    nodes, *_ = filled(NodeSpacing(1000.0, NO_TURN))
    assert nodes.between_nodes(loop_between(np.random.default_rng(0), laps().poses, 50, 5)) is None


def test_the_covariance_of_a_loop_counts_the_odometry_to_its_nodes_only() -> None:
    nodes, chain, _ = filled(NodeSpacing(min_distance_m=8.5))
    loop = loop_between(np.random.default_rng(0), laps().poses, 75, 15)
    at_node = replace(loop, query=int(nodes.node_frames[7]), match=int(nodes.node_frames[2]))
    np.testing.assert_allclose(nodes.loop_covariance(at_node), loop.covariance, atol=1e-15)
    query = chain.between(int(nodes.node_frames[nodes[75].node]), 75).covariance
    assert np.linalg.eigvalsh(nodes.loop_covariance(loop) - loop.covariance - query).min() >= -1e-12
