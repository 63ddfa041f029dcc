"""The map while driving: iSAM2 over key frames, where loops can be taken in and taken out again.

iSAM2 (Kaess et al., IJRR 2012) hears of the motions since the last loop only when the next one comes: until
then they move nothing. A loop that is taken out leaves no trace but the points of linearisation, which are
then chosen anew.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from slam import pose_graph_solver as solver
from slam.loop_closing import LoopClosure
from slam.pose_graph_what_if import surprise

Array = NDArray[np.float64]


@dataclass(frozen=True)
class IncrementalConfig:
    """How iSAM2 works."""

    width: float = 4.0  # Huber width of a loop, sigmas
    relinearize_threshold: float = 0.1  # change of a pose that has it linearised again, rad or m


class IncrementalMap:
    """Keys in a chain, numbered from 0, and the loops between them that are in use.

    All poses are T_world_key in metres, key 0 at the identity; covariances belong to right perturbations,
    rotation first.
    """

    def __init__(self, config: IncrementalConfig) -> None:
        self._config = config
        self._isam = _isam(config)
        self._graph, self._values = gtsam.NonlinearFactorGraph(), gtsam.Values()  # what iSAM2 has not heard of
        self._graph.add(solver.anchor(np.eye(4)))
        self._values.insert(0, gtsam.Pose3())
        self._estimate = gtsam.Values(self._values)
        self._newest = 0
        self._plain: dict[int, gtsam.BetweenFactorPose3] = {}
        self._slots: dict[int, int] = {}  # iSAM2's index of each loop in use
        self._fresh: list[tuple[int, int]] = []  # loop, its place in the waiting graph
        self._gone: list[int] = []

    @property
    def T_world_newest(self) -> Array:
        """(4, 4) of the newest key."""
        return self.pose(self._newest)

    @property
    def used(self) -> tuple[int, ...]:
        """Numbers of the loops in use, by number."""
        return tuple(sorted([*self._slots, *(loop for loop, _ in self._fresh)]))

    def add_key(self, T_previous_key: Array, covariance: Array) -> None:
        """Add the next key by its motion (4, 4) and covariance (6, 6)."""
        pose = gtsam.Pose3(self.T_world_newest @ T_previous_key)
        self._newest += 1
        self._graph.add(solver.odometry_factor(self._newest - 1, self._newest, T_previous_key, covariance))
        self._values.insert(self._newest, pose)
        self._estimate.insert(self._newest, pose)

    def know(self, number: int, loop: LoopClosure) -> None:
        """Learn of a loop between keys without using it yet."""
        self._plain[number] = solver.loop_factor(loop)

    def use(self, loops: Mapping[int, LoopClosure]) -> None:
        """Take known loops in, from the next `step` on."""
        for number, loop in loops.items():
            self._fresh.append((number, self._graph.size()))
            self._graph.add(solver.doubted_factor(loop, self._config.width))

    def drop(self, numbers: Iterable[int]) -> None:
        """Take loops in use out, from the next `step` on; their effect is undone."""
        self._gone += [self._slots.pop(number) for number in numbers]

    def step(self) -> bool:
        """Take one step of optimisation.

        Returns:
            Whether the map has come to rest: no pose had to be linearised again, and nothing is new.
        """
        fresh = self._tell() if self._graph.size() or self._gone else False
        result = self._isam.update()
        self._estimate = self._isam.calculateEstimate()
        return not fresh and not result.getVariablesRelinearized()

    def _tell(self) -> bool:
        """Hand over to iSAM2 what it has not heard of; whether that can move anything."""
        moving = bool(self._fresh or self._gone)
        removed, self._gone = self._gone, []
        result = self._isam.update(self._graph, self._values, removed, force_relinearize=bool(removed))
        indices = result.getNewFactorsIndices()
        self._slots |= {number: indices[place] for number, place in self._fresh}
        self._graph, self._values, self._fresh = gtsam.NonlinearFactorGraph(), gtsam.Values(), []
        return moving

    def chi2(self, numbers: Sequence[int]) -> Array:
        """(L,) chi-square of known loops at the map, their own covariance alone."""
        return np.array([2.0 * self._plain[number].error(self._estimate) for number in numbers])

    def surprise(self, loop: LoopClosure, drift: Array) -> float:
        """Chi-square of a loop not in use against the map and how sure the map is of it.

        Args:
            loop: between keys.
            drift: (6, 6) covariance of T_match_query that the map knows nothing of.
        """
        self._tell()
        joint = self._isam.jointMarginalCovariance([loop.match, loop.query])
        return surprise(self._estimate, joint, loop, drift)

    def pose(self, key: int) -> Array:
        """T_world_key (4, 4) of a key."""
        return self._estimate.atPose3(key).matrix()

    def poses(self) -> Array:
        """T_world_key (K, 4, 4) of all keys."""
        return solver.to_poses(self._estimate)


def _isam(config: IncrementalConfig) -> gtsam.ISAM2:
    params = gtsam.ISAM2Params()
    params.setRelinearizeThreshold(config.relinearize_threshold)
    params.relinearizeSkip = 1
    params.enablePartialRelinearizationCheck = True  # stops at quiet cliques: a third less time
    return gtsam.ISAM2(params)
