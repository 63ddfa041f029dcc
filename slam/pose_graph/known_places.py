"""Known places: where the map has enough nodes, the camera is located on them instead of making more.

A place that was passed `max_passes` times has a node of each pass. On later passes a loop that agrees with the map adds
no node and no edge: it locates the camera on the node of its match, by a Kalman filter that fuses it with odometry. So
the online graph grows with the map, not with the drive. (Johannsson et al., ICRA 2013, keep every such loop as an edge
between earlier nodes.) The loops are all kept for the final optimisation.

Frames that are located one after another are a `LocatedRun`. It rests on the loops that tied the camera to the map
before it; if these are all taken out, the run is undone, and its frames become nodes.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from slam.loop_closing.loop_closer import LoopClosure
from slam.pose_graph.isam2 import IncrementalPoseGraph
from slam.pose_graph.node_chain import NewNode, NodeChain
from slam.pose_graph.odometry_chain import OdometryChain

Array = NDArray[np.float64]
Frames = NDArray[np.int64]


@dataclass(frozen=True)
class KnownPlaceConfig:
    """When a place is known well enough.

    Attributes:
        max_passes: passes of a place of which the map keeps nodes.
        max_distance_m: maximum distance between a camera and a node of its place, metres.
        max_angle_rad: maximum angle between their directions, radians.
        min_path_m: path length between two passes, metres.
    """

    max_passes: int = 3
    max_distance_m: float = 5.0
    max_angle_rad: float = 0.5
    min_path_m: float = 10.0


@dataclass
class LocatedRun:
    """Frames that were located in known places, one after another.

    Attributes:
        first: the first frame.
        last: the last frame.
        support: numbers of the loops that tied the camera to the map before it.
        loops: loops by which the frames were located, by their numbers.
    """

    first: int
    last: int
    support: frozenset[int]
    loops: dict[int, LoopClosure] = field(default_factory=dict)


class KnownPlaces:
    """Locates the camera in known places, and undoes it.

    Args:
        chain: odometry of all frames.
        nodes: nodes of the online graph, with the frames attached to them.
        graph: the online graph.
        config: when a place is known.
    """

    def __init__(
        self, chain: OdometryChain, nodes: NodeChain, graph: IncrementalPoseGraph, config: KnownPlaceConfig
    ) -> None:
        self._chain, self._nodes, self._graph, self._config = chain, nodes, graph, config
        self._runs: list[LocatedRun] = []

    def uses(self, number: int) -> bool:
        """Whether a loop locates the camera."""
        return any(number in run.loops for run in reversed(self._runs))

    def contain(self, frame: int) -> bool:
        """Whether the frame, and those before it that have no node yet, are in known places."""
        first = min(self._nodes.num_attached, frame)
        return all(self._num_passes(k) >= self._config.max_passes for k in self._sample(first, frame))

    def locate(self, number: int, loop: LoopClosure, find_support: Callable[[int], frozenset[int]]) -> None:
        """Locate the frames up to the query of a loop.

        Args:
            number: number of the loop.
            loop: the loop between frames, noise floor included.
            find_support: function that returns the numbers of the loops in use that tie a frame to the map.
        """
        first = self._nodes.num_attached
        if not self._runs or self._runs[-1].last != first - 1:
            self._runs.append(LocatedRun(first, first - 1, find_support(first - 1)))
        run = self._runs[-1]
        run.loops[number] = loop
        if loop.query < first:
            return
        frames = np.arange(first, loop.query + 1)
        match = self._nodes[loop.match]
        nodes, T_node_frames = self._nodes.places_of(frames)
        T_match_frames = (
            se3.inverse(self._graph.pose(match.node)) @ self._graph.poses_of(nodes.tolist()) @ T_node_frames
        )
        predicted = self._predicted_covariance(loop.query)
        measured = se3.compose_covariance(match.covariance, loop.T_match_query, loop.covariance)
        gain = predicted @ np.linalg.inv(predicted + measured)
        error = se3.log(se3.inverse(T_match_frames[-1]) @ match.T_node_frame @ loop.T_match_query)
        shares = np.arange(1, len(frames) + 1) / len(frames)
        corrections = np.array([se3.exp(share * (gain @ error)) for share in shares])
        run.last = loop.query
        self._nodes.locate(match.node, T_match_frames @ corrections, predicted - gain @ predicted)

    def undo_unsupported(self, used: set[int]) -> dict[int, LoopClosure]:
        """Undo the runs whose supporting loops are all out of use.

        Args:
            used: numbers of the loops in use.

        Returns:
            The loops by which their frames were located, by their numbers.
        """
        unsupported = [run for run in self._runs if not run.support & used]
        self._runs = [run for run in self._runs if run.support & used]
        for run in unsupported:
            self._undo(run)
        return {number: loop for run in unsupported for number, loop in run.loops.items()}

    def add_nodes(self, last: int) -> None:
        """Make nodes of the frames up to `last` that are far enough from one another."""
        for node in self._nodes.attach(last):
            self._add(node)

    def _add(self, node: NewNode) -> None:
        self._graph.add_node(node.previous.node, node.previous.T_node_frame, node.previous.covariance)

    def _undo(self, run: LocatedRun) -> None:
        if run.last == self._nodes.num_attached - 1:
            self._nodes.detach(run.first)
            return
        made, after = self._nodes.insert_nodes(run.first, run.last)
        for node in made:
            self._add(node)
        if after is None:
            return
        before = after.previous
        self._graph.replace_motion(before.node, after.number, before.T_node_frame, before.covariance)

    def _predicted_covariance(self, query: int) -> Array:
        """Covariance (6, 6) of a frame, relative to a node of the map nearby, by odometry since the last one."""
        last = self._nodes.num_attached - 1
        before = self._nodes[last].covariance
        motion = self._chain.between_without_bias(last, query)
        # The map between the two nodes is about as uncertain as the odometry on the same way.
        return se3.compose_covariance(before, motion.T_first_second, 2.0 * motion.covariance)

    def _sample(self, first: int, last: int) -> list[int]:
        """Frames that stand for those from `first` to `last`."""
        frames, path_length_m = [last], self._chain.path_length_m
        for frame in range(last - 1, first - 1, -1):
            if path_length_m(frames[-1]) - path_length_m(frame) >= self._config.max_distance_m:
                frames.append(frame)
        return frames

    def _num_passes(self, frame: int) -> int:
        """Number of earlier passes of a frame's place that have nodes."""
        T_world_nodes, config = self._graph.poses(), self._config
        (node,), (T_node_frame,) = self._nodes.places_of(np.array([frame]))
        T = T_world_nodes[node] @ T_node_frame
        near = np.linalg.norm(T_world_nodes[:, :3, 3] - T[:3, 3], axis=1) <= config.max_distance_m
        near &= T_world_nodes[:, :3, 2] @ T[:3, 2] >= np.cos(config.max_angle_rad)
        path = np.array([self._chain.path_length_m(k) for k in self._nodes.node_frames[near]])
        path = np.sort(path[path <= self._chain.path_length_m(frame) - config.min_path_m])
        return int((np.diff(path, prepend=-np.inf) > config.min_path_m).sum())
