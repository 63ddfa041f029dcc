"""Incremental pose graph: iSAM2 on the nodes of the online graph, to which loops can be added and removed.

iSAM2 (Kaess et al., IJRR 2012) gets the motions since the last loop only when the next loop comes: until then they
change no pose. A loop that is removed leaves no trace but the points of linearisation, which are then chosen anew.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from slam.loop_closing.loop_closer import LoopClosure
from slam.pose_graph.loop_clusters import predictive_chi2
from slam.pose_graph.optimization import gtsam_solver as factors

Array = NDArray[np.float64]


@dataclass(frozen=True)
class IncrementalConfig:
    """Settings of iSAM2.

    Attributes:
        huber_width_sigma: Huber width of a loop, sigmas.
        relinearize_threshold: change of a pose after which it is linearised again, rad or m.
    """

    huber_width_sigma: float = 4.0
    relinearize_threshold: float = 0.1


class IncrementalPoseGraph:
    """Nodes in a chain, numbered from 0, and the loops between them that are in use.

    All poses are T_world_node in metres, node 0 at the identity; covariances belong to right perturbations,
    rotation first.
    """

    def __init__(self, config: IncrementalConfig) -> None:
        self._config = config
        self._isam = _isam(config)
        self._graph, self._values = gtsam.NonlinearFactorGraph(), gtsam.Values()  # new, not yet in iSAM2
        self._graph.add(factors.prior_factor(np.eye(4)))
        self._values.insert(0, gtsam.Pose3())
        self._estimate = gtsam.Values(self._values)
        self._newest = 0
        self._registered: dict[int, gtsam.BetweenFactorPose3] = {}
        self._factor_indices: dict[int, int] = {}  # iSAM2's index of each loop in use
        self._pending_loops: list[tuple[int, int]] = []  # loop and its index in the new graph
        self._removed: list[int] = []

    @property
    def T_world_newest(self) -> Array:
        """T_world_node (4, 4) of the newest node."""
        return self.pose(self._newest)

    @property
    def used(self) -> tuple[int, ...]:
        """Numbers of the loops in use, sorted."""
        return tuple(sorted([*self._factor_indices, *(loop for loop, _ in self._pending_loops)]))

    def add_node(self, T_previous_node: Array, covariance: Array) -> None:
        """Add the next node by its motion (4, 4) and covariance (6, 6)."""
        pose = gtsam.Pose3(self.T_world_newest @ T_previous_node)
        self._newest += 1
        self._graph.add(factors.odometry_factor(self._newest - 1, self._newest, T_previous_node, covariance))
        self._values.insert(self._newest, pose)
        self._estimate.insert(self._newest, pose)

    def register_loop(self, number: int, loop: LoopClosure) -> None:
        """Register a loop between nodes for `chi2` and `add_loops`, without using it yet."""
        self._registered[number] = factors.loop_factor(loop)

    def add_loops(self, loops: Mapping[int, LoopClosure]) -> None:
        """Use registered loops from the next `step` on."""
        for number, loop in loops.items():
            self._pending_loops.append((number, self._graph.size()))
            self._graph.add(factors.huber_factor(loop, self._config.huber_width_sigma))

    def remove_loops(self, numbers: Iterable[int]) -> None:
        """Stop using loops from the next `step` on; their effect is undone."""
        self._removed += [self._factor_indices.pop(number) for number in numbers]

    def step(self) -> bool:
        """Do one step of optimisation.

        Returns:
            Whether the map is at rest: no pose was linearised again, and no loop has been added or removed.
        """
        is_changed = self._flush() if self._graph.size() or self._removed else False
        result = self._isam.update()
        self._estimate = self._isam.calculateEstimate()
        return not is_changed and not result.getVariablesRelinearized()

    def _flush(self) -> bool:
        """Pass new nodes and changes of loops to iSAM2; whether there were changes of loops."""
        is_changed = bool(self._pending_loops or self._removed)
        removed, self._removed = self._removed, []
        result = self._isam.update(self._graph, self._values, removed, force_relinearize=bool(removed))
        indices = result.getNewFactorsIndices()
        self._factor_indices |= {number: indices[index] for number, index in self._pending_loops}
        self._graph, self._values, self._pending_loops = gtsam.NonlinearFactorGraph(), gtsam.Values(), []
        return is_changed

    def chi2(self, numbers: Sequence[int]) -> Array:
        """(L,) chi-square of registered loops at the map, by their own covariance alone."""
        return np.array([2.0 * self._registered[number].error(self._estimate) for number in numbers])

    def predictive_chi2(self, loop: LoopClosure, bias: Array) -> float:
        """Chi-square of a loop that is not in use against the map, by the covariances of both.

        Args:
            loop: loop between nodes.
            bias: (6, 6) covariance of T_match_query by odometry's bias, which the graph does not model.
        """
        self._flush()
        joint = self._isam.jointMarginalCovariance([loop.match, loop.query])
        return predictive_chi2(self._estimate, joint, loop, bias)

    def pose(self, node: int) -> Array:
        """T_world_node (4, 4) of a node."""
        return self._estimate.atPose3(node).matrix()

    def poses(self) -> Array:
        """T_world_node (K, 4, 4) of all nodes."""
        return factors.to_poses(self._estimate)


def _isam(config: IncrementalConfig) -> gtsam.ISAM2:
    params = gtsam.ISAM2Params()
    params.setRelinearizeThreshold(config.relinearize_threshold)
    params.relinearizeSkip = 1
    params.enablePartialRelinearizationCheck = True  # stops at cliques that did not move: a third less time
    return gtsam.ISAM2(params)
