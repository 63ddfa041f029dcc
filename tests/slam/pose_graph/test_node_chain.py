"""Frames are attached to nodes, and loops move to the nodes without a change of what they measure."""

import numpy as np
import pytest

from odometry import se3
from slam.pose_graph.node_chain import NodeChain, NodeSpacing
from slam.pose_graph.odometry_chain import OdometryChain, OdometryDriftModel

from ..laps import LOOP_COVARIANCE, STEP_COVARIANCE, laps, loop_between

NO_TURN = 1e9  # radians: turning makes no node


def filled(spacing: NodeSpacing) -> tuple[NodeChain, OdometryChain, list[np.ndarray]]:
    """Nodes and chain of a noisy lap, and T_world_node of each node."""
    nodes, chain = NodeChain(spacing), OdometryChain(OdometryDriftModel(0.0, 0.0))
    T_world_nodes = [np.eye(4)]
    for T in laps(laps=1.0).motions:
        chain.append(T, STEP_COVARIANCE)
        node = nodes.append(T, STEP_COVARIANCE)
        if node is not None:
            T_world_nodes.append(T_world_nodes[-1] @ node.T_node_frame)
    return nodes, chain, T_world_nodes


@pytest.mark.parametrize("min_distance_m", [0.0, 2.5, 10.0, 1000.0])
def test_frames_on_unmoved_nodes_lie_where_odometry_puts_them(min_distance_m: float) -> None:
    nodes, chain, T_world_nodes = filled(NodeSpacing(min_distance_m, NO_TURN))
    np.testing.assert_allclose(nodes.poses(np.array(T_world_nodes)), chain.poses, atol=1e-9)


def test_a_frame_becomes_a_node_after_a_distance_or_after_turning_on_the_spot() -> None:
    nodes = NodeChain(NodeSpacing(min_distance_m=2.5, min_angle_rad=0.5))
    forward, turn = se3.exp(np.array([0, 0, 0, 0, 0, 1.0])), se3.exp(np.array([0, 0.2, 0, 0, 0, 0]))
    assert [nodes.append(forward, STEP_COVARIANCE) is not None for _ in range(6)] == [False, False, True] * 2
    assert [nodes.append(turn, STEP_COVARIANCE) is not None for _ in range(6)] == [False, False, True] * 2


def test_standing_still_makes_no_nodes() -> None:
    nodes = NodeChain(NodeSpacing())
    assert all(nodes.append(np.eye(4), STEP_COVARIANCE) is None for _ in range(50))
    assert nodes[50].node == 0


def test_a_frame_has_the_covariance_of_the_chain_from_its_node() -> None:
    nodes, chain, _ = filled(NodeSpacing(10.0, NO_TURN))
    first = next(k for k in range(1, 100) if nodes[k].node == 3)
    np.testing.assert_allclose(nodes[first + 6].covariance, chain.between(first, first + 6).covariance, atol=1e-12)


def test_a_loop_between_nodes_measures_the_same_as_the_loop_between_frames() -> None:
    drive = laps()
    nodes = NodeChain(NodeSpacing(min_distance_m=4.5))
    T_world_nodes = [np.eye(4)]
    true = se3.inverse(drive.poses[:-1]) @ drive.poses[1:]
    for T in true:
        node = nodes.append(T, STEP_COVARIANCE)
        if node is not None:
            T_world_nodes.append(T_world_nodes[-1] @ node.T_node_frame)
    loop = loop_between(np.random.default_rng(0), drive.poses, 113, 12)
    between_nodes = nodes.between_nodes(loop)
    assert between_nodes is not None
    T_match_query = se3.inverse(T_world_nodes[between_nodes.match]) @ T_world_nodes[between_nodes.query]
    own = se3.inverse(loop.T_match_query) @ se3.inverse(drive.poses[12]) @ drive.poses[113]
    moved = se3.inverse(between_nodes.T_match_query) @ T_match_query
    assert se3.angle(own) == pytest.approx(se3.angle(moved), abs=1e-9)
    assert np.linalg.eigvalsh(between_nodes.covariance - 0.99 * LOOP_COVARIANCE.min() * np.eye(6)).min() > 0


def test_the_covariance_of_a_moved_loop_is_that_of_random_trials() -> None:
    rng, nodes = np.random.default_rng(2), NodeChain(NodeSpacing(min_distance_m=8.5))
    for T in laps(laps=1.0).motions:
        nodes.append(T, STEP_COVARIANCE)
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
