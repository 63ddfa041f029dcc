"""Incremental pose graph: iSAM2 on the nodes of the online graph, to which loops can be added and removed.

iSAM2 (Kaess et al., IJRR 2012) gets the motions since the last loop only when the next loop comes: until then they
change no pose. A loop that is removed leaves no trace but the points of linearisation, which are then chosen anew.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

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

    Attributes:
        num_nodes: number of nodes.
    """

    def __init__(self, config: IncrementalConfig) -> None:
        self._config = config
        self._isam = _isam(config)
        self._graph, self._values = gtsam.NonlinearFactorGraph(), gtsam.Values()  # new, not yet in iSAM2
        self._graph.add(factors.prior_factor(np.eye(4)))
        self._values.insert(0, gtsam.Pose3())
        self._estimate = gtsam.Values(self._values)
        self.num_nodes = 1
        # iSAM2's index of each loop in use, and of the motion to each node; of new ones their index in the new graph.
        self._loops, self._motions = _FactorIndices(), _FactorIndices()
        self._factors: dict[int, gtsam.BetweenFactorPose3] = {}  # of the loops in use, without Huber's kernel
        self._removed: list[int] = []
        self._poses: Array | None = None

    @property
    def used(self) -> tuple[int, ...]:
        """Numbers of the loops in use, sorted."""
        return tuple(sorted([*self._loops.known, *self._loops.new]))

    @property
    def has_loops(self) -> bool:
        """Whether a loop is in use."""
        return bool(self._loops.known or self._loops.new)

    def uses(self, number: int) -> bool:
        """Whether a loop is in use."""
        return number in self._loops.known or number in self._loops.new

    def add_node(self, previous: int, T_previous_node: Array, covariance: Array) -> None:
        """Add the next node by its motion (4, 4) from an earlier one, and its covariance (6, 6)."""
        node, self.num_nodes = self.num_nodes, self.num_nodes + 1
        pose = gtsam.Pose3(self.pose(previous) @ T_previous_node)
        self._values.insert(node, pose)
        self._estimate.insert(node, pose)
        self._add_motion(previous, node, T_previous_node, covariance)
        self._poses = None

    def replace_motion(self, previous: int, node: int, T_previous_node: Array, covariance: Array) -> None:
        """Join a node to another one than before, by a motion (4, 4) with covariance (6, 6)."""
        self._flush()
        self._removed.append(self._motions.known.pop(node))
        self._add_motion(previous, node, T_previous_node, covariance)

    def add_loops(self, loops: Mapping[int, LoopClosure]) -> None:
        """Use loops between nodes, by their numbers, from the next `step` on."""
        for number, loop in loops.items():
            self._loops.new[number], self._factors[number] = self._graph.size(), factors.loop_factor(loop)
            self._graph.add(factors.huber_factor(loop, self._config.huber_width_sigma))

    def remove_loops(self, numbers: Iterable[int]) -> None:
        """Stop using loops from the next `step` on; their effect is undone."""
        for number in numbers:
            self._removed.append(self._loops.known.pop(number))
            del self._factors[number]

    def step(self) -> bool:
        """Do one step of optimisation.

        Returns:
            Whether the map is at rest: no pose was linearised again, and no loop has been added or removed.
        """
        is_changed = self._flush() if self._graph.size() or self._removed else False
        result = self._isam.update()
        self._estimate, self._poses = self._isam.calculateEstimate(), None
        return not is_changed and not result.getVariablesRelinearized()

    def chi2(self, numbers: Sequence[int]) -> Array:
        """(L,) chi-square of loops in use at the map, by their own covariance alone."""
        return np.array([2.0 * self._factors[number].error(self._estimate) for number in numbers])

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

    def poses_of(self, nodes: Iterable[int]) -> Array:
        """T_world_node (M, 4, 4) of some nodes."""
        return np.array([self.pose(node) for node in nodes])

    def poses(self) -> Array:
        """T_world_node (K, 4, 4) of all nodes; not to be changed."""
        if self._poses is None:
            self._poses = factors.to_poses(self._estimate)
        return self._poses

    def _flush(self) -> bool:
        """Pass new nodes and changes of loops to iSAM2; whether there were changes of loops."""
        is_changed = bool(self._loops.new or self._removed)
        removed, self._removed = self._removed, []
        result = self._isam.update(self._graph, self._values, removed, force_relinearize=bool(removed))
        indices = result.getNewFactorsIndices()
        for factor_indices in (self._loops, self._motions):
            factor_indices.settle(indices)
        self._graph, self._values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        return is_changed

    def _add_motion(self, previous: int, node: int, T_previous_node: Array, covariance: Array) -> None:
        self._motions.new[node] = self._graph.size()
        self._graph.add(factors.odometry_factor(previous, node, T_previous_node, covariance))


@dataclass
class _FactorIndices:
    """Indices of factors by the number of what they measure.

    Attributes:
        new: index in the graph that iSAM2 has not seen yet.
        known: index in iSAM2.
    """

    new: dict[int, int] = field(default_factory=dict)
    known: dict[int, int] = field(default_factory=dict)

    def settle(self, indices: Sequence[int]) -> None:
        """Take the indices (M,) that iSAM2 has given to the new factors."""
        self.known |= {number: indices[index] for number, index in self.new.items()}
        self.new = {}


def _isam(config: IncrementalConfig) -> gtsam.ISAM2:
    params = gtsam.ISAM2Params()
    params.setRelinearizeThreshold(config.relinearize_threshold)
    params.relinearizeSkip = 1
    params.enablePartialRelinearizationCheck = True  # stops at cliques that did not move: a third less time
    return gtsam.ISAM2(params)
