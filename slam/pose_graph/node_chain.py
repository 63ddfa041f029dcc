"""Nodes of the online graph: frames at some distance; every other frame is rigidly attached to the node before it.

A loop between two frames is moved to their nodes along odometry, whose error over the short path is added to
the loop's own. Fewer nodes make each loop several times cheaper and change the map by less than its noise.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from slam.loop_closing.loop_closer import LoopClosure

Array = NDArray[np.float64]


@dataclass(frozen=True)
class NodeSpacing:
    """When a frame becomes a node of the online graph.

    Attributes:
        min_distance_m: path length since the last node after which a frame becomes a node, metres.
        min_angle_rad: rotation since the last node after which a frame becomes a node, radians.
    """

    min_distance_m: float = 2.5
    min_angle_rad: float = 0.5


@dataclass(frozen=True)
class NodeAttachment:
    """A frame, attached to a node of the online graph.

    Attributes:
        node: number of the node, counted from 0.
        T_node_frame: (4, 4), metres; the identity for the node itself.
        covariance: (6, 6) of its right perturbation, rotation first; zero for the node itself.
    """

    node: int
    T_node_frame: Array
    covariance: Array


class NodeChain:
    """Frames in their order, each attached to a node; frame 0 is node 0."""

    def __init__(self, spacing: NodeSpacing) -> None:
        self._spacing = spacing
        self._attachments = [_as_node(0)]
        self._distance_m = self._angle_rad = 0.0

    def append(self, T_previous_current: Array, covariance: Array) -> NodeAttachment | None:
        """Attach the next frame by its motion (4, 4) and covariance (6, 6).

        Returns:
            Attachment of the frame to the node before it if the frame has become a node itself, else None.
        """
        before = self._attachments[-1]
        moved = NodeAttachment(
            before.node,
            before.T_node_frame @ T_previous_current,
            se3.compose_covariance(before.covariance, T_previous_current, covariance),
        )
        self._distance_m += float(np.linalg.norm(T_previous_current[:3, 3]))
        # The chord of the rotation is its angle as long as it is small, and is cheaper than the angle.
        self._angle_rad += float(np.linalg.norm(T_previous_current[:3, :3] - np.eye(3))) / np.sqrt(2.0)
        if self._distance_m < self._spacing.min_distance_m and self._angle_rad < self._spacing.min_angle_rad:
            self._attachments.append(moved)
            return None
        self._attachments.append(_as_node(before.node + 1))
        self._distance_m = self._angle_rad = 0.0
        return moved

    def __getitem__(self, frame: int) -> NodeAttachment:
        return self._attachments[frame]

    def poses(self, T_world_nodes: Array) -> Array:
        """T_world_camera (N, 4, 4) of all frames on nodes (K, 4, 4)."""
        nodes = [attachment.node for attachment in self._attachments]
        return T_world_nodes[nodes] @ np.array([attachment.T_node_frame for attachment in self._attachments])

    def between_nodes(self, closure: LoopClosure) -> LoopClosure | None:
        """A loop between frames as a loop between their nodes; None if both frames belong to one node."""
        match, query = self._attachments[closure.match], self._attachments[closure.query]
        if match.node == query.node:
            return None
        T_query_node, Ad = se3.inverse(query.T_node_frame), se3.adjoint(query.T_node_frame)
        T_match_node = closure.T_match_query @ T_query_node
        # The motion back from the query to its node: the inverse of a motion has its covariance moved by the adjoint.
        own = se3.compose_covariance(closure.covariance, T_query_node, Ad @ query.covariance @ Ad.T)
        return replace(
            closure,
            query=query.node,
            match=match.node,
            T_match_query=match.T_node_frame @ T_match_node,
            covariance=se3.compose_covariance(match.covariance, T_match_node, own),
        )


def _as_node(number: int) -> NodeAttachment:
    return NodeAttachment(number, np.eye(4), np.zeros((6, 6)))
