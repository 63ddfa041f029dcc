"""Nodes of the online graph, and how each frame is attached to one of them.

Some frames are *references*: the first, one at every spacing, and those that were located in a known place. A reference
is a node or lies at a pose relative to one; every other frame follows a reference by odometry. The first `num_attached`
frames have their nodes. Later references become nodes when a loop needs them; until then they follow by odometry.

A loop between two frames is moved to their nodes, and the error of odometry over the short path is added to its own.
Fewer nodes make each loop several times cheaper and change the map by less than its noise.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from place_recognition.growing_array import GrowingArray
from slam.loop_closing.loop_closer import LoopClosure
from slam.pose_graph.odometry_chain import OdometryChain

Array = NDArray[np.float64]
Frames = NDArray[np.int64]

_UNKNOWN = -1  # node of a reference that has none yet


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


@dataclass(frozen=True)
class NewNode:
    """A node that is added to the online graph.

    Attributes:
        number: its number.
        previous: the node to which odometry joins it, and the motion from there.
    """

    number: int
    previous: NodeAttachment


class NodeChain:
    """Frames in their order, each attached to a node; frame 0 is node 0.

    Args:
        chain: odometry of the frames; a frame is added there first.
        spacing: selection of the nodes.

    Attributes:
        num_attached: number of frames, from the first on, that have their nodes.
    """

    def __init__(self, chain: OdometryChain, spacing: NodeSpacing) -> None:
        self._chain, self._spacing = chain, spacing
        self._turned_rad = GrowingArray(np.float64)  # rotation up to each frame, added up
        self._references = GrowingArray(np.int64)  # frame of the reference that each frame follows
        # Of each reference; the rows of other frames are not used.
        self._nodes, self._T_node_frame = GrowingArray(np.int64), GrowingArray(np.float64)
        self._covariances = GrowingArray(np.float64)
        self._node_frames = GrowingArray(np.int64)
        self.num_attached = 0
        self._append(0.0, 0)
        self.attach(0)

    def __len__(self) -> int:
        return len(self._references)

    @property
    def node_frames(self) -> Frames:
        """(K,) frame of each node."""
        return self._node_frames.rows.copy()

    def append(self) -> None:
        """Add the frame that was added to the odometry."""
        frame, reference = len(self), int(self._references.rows[-1])
        turn = self._chain[frame - 1][:3, :3].T @ self._chain[frame][:3, :3]
        # The chord of the rotation is its angle as long as it is small, and is cheaper than the angle.
        self._append(self._turned_rad.rows[-1] + np.linalg.norm(turn - np.eye(3)) / np.sqrt(2.0), reference)
        self._space(frame, reference)

    def attach(self, last: int) -> list[NewNode]:
        """Attach the frames up to `last`: their references become nodes, which are returned in their order."""
        first, self.num_attached = self.num_attached, max(self.num_attached, last + 1)
        return self._make_nodes(first, self.num_attached)

    def locate(self, node: int, T_node_frames: Array, covariance: Array) -> None:
        """Attach frames that were located on a node which is there already.

        Args:
            node: number of the node.
            T_node_frames: (n, 4, 4) the next n frames that have no node, metres.
            covariance: (6, 6) of the right perturbation of each of them, rotation first.
        """
        frames = np.arange(self.num_attached, self.num_attached + len(T_node_frames))
        self._references.rows[frames] = frames
        self._nodes.rows[frames] = node
        self._T_node_frame.rows[frames] = T_node_frames
        self._covariances.rows[frames] = covariance
        self.num_attached += len(frames)
        later = self._references.rows[self.num_attached :]
        later[later < self.num_attached] = self.num_attached - 1

    def detach(self, first: int) -> None:
        """Undo the attachment of all frames from `first` on; they follow the frame before by odometry again."""
        reference = int(self._references.rows[first - 1])
        self._nodes.rows[first:] = _UNKNOWN
        self.num_attached = first
        for frame in range(first, len(self)):
            reference = self._space(frame, reference)

    def insert_nodes(self, first: int, last: int) -> tuple[list[NewNode], NewNode | None]:
        """Replace the places of located frames by nodes of their own.

        Args:
            first: the first of the frames.
            last: the last of them; frames behind it have been attached since.

        Returns:
            The new nodes, and the first node behind them, which is now joined to the last of them. None where there is
            no such node: where nothing behind them has become one yet, or was located in a known place again.
        """
        reference = int(self._references.rows[first - 1])
        after = last + 1
        while after < len(self) and self._references.rows[after] <= last:
            after += 1
        self._nodes.rows[first:after] = _UNKNOWN
        for frame in range(first, after):
            reference = self._space(frame, reference)
        made = self._make_nodes(first, min(after, self.num_attached))
        if after >= self.num_attached or self._node_frames.rows[self._nodes.rows[after]] != after:
            return made, None
        return made, NewNode(int(self._nodes.rows[after]), self._follow(after - 1, after))

    def __getitem__(self, frame: int) -> NodeAttachment:
        if frame < self.num_attached:
            return self._follow(int(self._references.rows[frame]), frame)
        return self._follow(self.num_attached - 1, frame)

    def places_of(self, frames: Frames) -> tuple[Frames, Array]:
        """Nodes (N,) of frames (N,), and T_node_frame (N, 4, 4)."""
        references = self._references.rows[np.minimum(frames, self.num_attached - 1)]
        T_reference_frames = se3.inverse(self._chain.poses_of(references)) @ self._chain.poses_of(frames)
        return self._nodes.rows[references], np.asarray(self._T_node_frame.rows[references] @ T_reference_frames)

    def poses(self, T_world_nodes: Array) -> Array:
        """T_world_camera (N, 4, 4) of all frames, by the poses of the nodes (K, 4, 4)."""
        nodes, T_node_frames = self.places_of(np.arange(len(self)))
        return np.asarray(T_world_nodes[nodes] @ T_node_frames)

    def loop_covariance(self, loop: LoopClosure) -> Array:
        """Covariance (6, 6) of a loop and of the odometry from its frames to the references that they follow."""
        match, query = (self._since_reference(frame) for frame in (loop.match, loop.query))
        return se3.compose_covariance(match, loop.T_match_query, loop.covariance) + query

    def between_nodes(self, closure: LoopClosure) -> LoopClosure | None:
        """A loop between frames as a loop between their nodes; None if both frames belong to one node."""
        match, query = self[closure.match], self[closure.query]
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

    def follow_the_same(self, first: int, second: int) -> bool:
        """Whether two frames follow the same reference, by odometry alone."""
        a, b = self._references.rows[[first, second]]
        return bool(a == b)

    def _append(self, turned_rad: float, reference: int) -> None:
        self._turned_rad.extend(np.array([turned_rad]))
        self._references.extend(np.array([reference]))
        self._nodes.extend(np.array([_UNKNOWN]))
        self._T_node_frame.extend(np.eye(4)[None])
        self._covariances.extend(np.zeros((1, 6, 6)))

    def _space(self, frame: int, reference: int) -> int:
        """Let a frame follow a reference, or be one itself if that is far enough; the frame that it follows."""
        distance = self._chain.path_length_m(frame) - self._chain.path_length_m(reference)
        turned = self._turned_rad.rows[frame] - self._turned_rad.rows[reference]
        if distance >= self._spacing.min_distance_m or turned >= self._spacing.min_angle_rad:
            reference = frame
        self._references.rows[frame] = reference
        return reference

    def _make_nodes(self, first: int, end: int) -> list[NewNode]:
        """Make nodes of the references without one among the frames from `first` on, up to and without `end`."""
        made = []
        for frame in range(first, end):
            if self._references.rows[frame] == frame and self._nodes.rows[frame] == _UNKNOWN:
                number = len(self._node_frames)
                if frame:
                    made.append(NewNode(number, self._follow(frame - 1, frame)))
                self._nodes.rows[frame] = number
                self._T_node_frame.rows[frame], self._covariances.rows[frame] = np.eye(4), 0.0
                self._node_frames.extend(np.array([frame]))
        return made

    def _follow(self, attached: int, frame: int) -> NodeAttachment:
        """Attachment of a frame by odometry since the reference of an attached one."""
        reference = int(self._references.rows[attached])
        place = NodeAttachment(
            int(self._nodes.rows[reference]), self._T_node_frame.rows[reference], self._covariances.rows[reference]
        )
        if frame == reference:
            return place
        motion = self._chain.between_without_bias(reference, frame)
        return NodeAttachment(
            place.node,
            place.T_node_frame @ motion.T_first_second,
            se3.compose_covariance(place.covariance, motion.T_first_second, motion.covariance),
        )

    def _since_reference(self, frame: int) -> Array:
        """Covariance (6, 6) of a frame relative to the node of its reference, or to the reference if it has none."""
        reference = int(self._references.rows[frame])
        motion = self._chain.between_without_bias(reference, frame)
        return se3.compose_covariance(self._covariances.rows[reference], motion.T_first_second, motion.covariance)
