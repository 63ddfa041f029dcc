"""Clusters of loops, and the leave-one-out test that finds the clusters which contradict the others.

A cluster holds loops of one stretch of the trajectory that agree with one another. Agreement is pairwise consistency
(Mangelson et al., ICRA 2018, equation 3): the cycle through two loops and the odometry between their ends must close.
Over a short stretch odometry hardly drifts, so that agreement is strong evidence.

A false cluster that odometry's drift can absorb lies close to the map that it has bent itself, however many true loops
there are; only the map without it shows the contradiction. The test therefore compares each cluster with the map that
the others make, by the predictive chi-square of a loop. That map is solved on the frames that the loops join alone:
between them odometry is one edge, whose covariance takes constant time, so that the graph is small however long the
trajectory.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice, pairwise

import gtsam
import numpy as np
from numpy.typing import NDArray

from odometry import se3
from slam.loop_closing.loop_closer import LoopClosure
from slam.pose_graph.odometry_chain import OdometryChain
from slam.pose_graph.optimization import gtsam_solver as factors

Array = NDArray[np.float64]
PredictiveChi2 = Callable[[int, Sequence[int]], float]  # of a loop against the map of others; loops by their numbers

_GAUSS_NEWTON_STEPS = 4  # a first guess; other numbers were not tried
# Earlier loops of the stretch that a new one is compared with, the latest first: bounds the time of a loop where a
# place is visited many times.
_MAX_COMPARED = 12
_REPRESENTATIVES = 6  # loops that stand for their cluster, evenly spread: neighbours measure nearly the same
# Share of the largest residual from which a cluster is a suspect. With 0.8, many false clusters together win.
_SUSPECT_RATIO = 0.5


@dataclass(frozen=True)
class LoopClusterConfig:
    """When loops belong to one cluster.

    Attributes:
        max_distance_m: maximum path length between two loops of one stretch, at both ends, metres.
        max_agreement_chi2: maximum chi-square (6 degrees of freedom) of the cycle through two loops that agree; 99.9 %
            of true pairs lie below 22.5.
        huber_width_sigma: Huber width of the loops of other clusters in the map that they make, sigmas.
    """

    max_distance_m: float = 30.0
    max_agreement_chi2: float = 22.5
    huber_width_sigma: float = 4.0


@dataclass(frozen=True)
class ClusteredLoop:
    """A loop and its cluster.

    Attributes:
        loop: the loop between frames.
        covariance: (6, 6) covariance of the loop and of the odometry to the nodes of its frames.
        cluster: number of the cluster's first loop.
    """

    loop: LoopClosure
    covariance: Array
    cluster: int


class LoopClusters:
    """Clusters of loops that grow as loops come; a cluster is named by the number of its first loop."""

    def __init__(self, chain: OdometryChain, config: LoopClusterConfig) -> None:
        self._chain, self._config = chain, config
        self._loops: dict[int, ClusteredLoop] = {}
        self._members: dict[int, list[int]] = {}
        self._by_cell: dict[tuple[int, int], list[int]] = {}  # loops by the path length up to match and query

    def __getitem__(self, number: int) -> ClusteredLoop:
        return self._loops[number]

    @property
    def numbers(self) -> list[int]:
        """Numbers of all loops, in the order in which they came."""
        return list(self._loops)

    @property
    def names(self) -> list[int]:
        """Names of all clusters, in the order of their first loops."""
        return list(self._members)

    def members(self, cluster: int) -> list[int]:
        """Numbers of the loops of a cluster, in the order in which they came."""
        return self._members[cluster]

    def add(self, number: int, loop: LoopClosure, covariance: Array) -> list[int]:
        """Add a loop to the cluster of the latest loop that agrees with it, or begin a new cluster.

        Args:
            number: number of the loop.
            loop: the loop between frames.
            covariance: (6, 6) covariance of the loop and of the odometry to the nodes of its frames.

        Returns:
            Loops of that cluster nearby, the latest first; empty where the loop begins a cluster.
        """
        row, column = self._cell(loop)
        cells = ((row + i, column + j) for i in (-1, 0, 1) for j in (-1, 0, 1))
        latest_first = sorted((k for cell in cells for k in self._by_cell.get(cell, ())), reverse=True)
        nearby = (k for k in latest_first if self._is_same_stretch(self._loops[k].loop, loop))
        near = list(islice(nearby, _MAX_COMPARED))
        agreeing = (k for k in near if self._cycle_chi2(self._loops[k].loop, loop) <= self._config.max_agreement_chi2)
        first = next(agreeing, None)
        cluster = number if first is None else self._loops[first].cluster
        self._loops[number] = ClusteredLoop(loop, covariance, cluster)
        self._by_cell.setdefault((row, column), []).append(number)
        self._members.setdefault(cluster, []).append(number)
        return [k for k in near if self._loops[k].cluster == cluster]

    def chi2_given_others(self, number: int, others: Sequence[int]) -> float:
        """Predictive chi-square of a loop against the map that odometry and the other loops alone make."""
        loops, bias = [self._loops[k].loop for k in others], self.bias_covariance(number, others)
        return predictive_chi2_given(self._loops[number].loop, loops, self._chain, self._config.huber_width_sigma, bias)

    def bias_covariance(self, number: int, others: Sequence[int]) -> Array:
        """Covariance (6, 6) of a loop's query by odometry's bias since the nearest frame at an end of another loop."""
        held = {frame for k in others for frame in (self._loops[k].loop.query, self._loops[k].loop.match)}
        query = self._loops[number].loop.query
        nearest = min(held, key=lambda frame: (abs(frame - query), frame), default=0)
        return self._chain.bias_covariance(nearest, query)

    def _cell(self, loop: LoopClosure) -> tuple[int, int]:
        """Cell of a loop in a grid, whose neighbours hold all loops of its stretch."""
        size, path_length = self._config.max_distance_m, self._chain.path_length_m
        return int(path_length(loop.match) // size), int(path_length(loop.query) // size)

    def _is_same_stretch(self, a: LoopClosure, b: LoopClosure) -> bool:
        limit, path_length = self._config.max_distance_m, self._chain.path_length_m
        if abs(path_length(a.query) - path_length(b.query)) > limit:
            return False
        return abs(path_length(a.match) - path_length(b.match)) <= limit

    def _cycle_chi2(self, a: LoopClosure, b: LoopClosure) -> float:
        """Chi-square of the cycle through two loops and the odometry between their ends."""
        matches, queries = self._chain.between(a.match, b.match), self._chain.between(a.query, b.query)
        by_a = a.T_match_query @ queries.T_first_second
        by_b = matches.T_first_second @ b.T_match_query
        covariance = se3.compose_covariance(a.covariance, queries.T_first_second, queries.covariance)
        covariance += se3.compose_covariance(matches.covariance, b.T_match_query, b.covariance)
        error = se3.log(se3.inverse(by_b) @ by_a)
        return float(error @ np.linalg.solve(covariance, error))


class LeaveOneOutTest:
    """Finds the clusters to leave out, the worst first, until the others agree; one comparison a step.

    Args:
        clusters: loops of each cluster, by their numbers.
        predictive_chi2: chi-square of a loop against the map of others.
        limit: chi-square from which a cluster contradicts the others.

    Attributes:
        left_out: chi-square against the others of each cluster to leave out.
    """

    def __init__(self, clusters: Mapping[int, Sequence[int]], predictive_chi2: PredictiveChi2, limit: float) -> None:
        self._clusters, self._predictive_chi2, self._limit = dict(clusters), predictive_chi2, limit
        self._remaining = self._testable()
        self._results: dict[int, float] = {}
        self.left_out: dict[int, float] = {}

    def step(self) -> bool:
        """Compare one cluster with the others; whether the test is over."""
        if self._remaining:
            cluster = self._remaining.pop()
            others = [
                k for other, members in self._clusters.items() if other != cluster for k in _representatives(members)
            ]
            members = self._clusters[cluster]
            self._results[cluster] = self._predictive_chi2(members[len(members) // 2], others)
        return not self._remaining and not self._leave_out_worst()

    def _testable(self) -> list[int]:
        """Clusters to compare: a single loop is in the map only because it changes nothing there."""
        if len(self._clusters) < 2:
            return []
        return [cluster for cluster, members in self._clusters.items() if len(members) > 1]

    def _leave_out_worst(self) -> bool:
        """Leave out the cluster that contradicts the others most, if one does; whether the test goes on."""
        worst = max(self._results.values(), default=0.0)
        if worst <= self._limit:
            return False
        # Two clusters that contradict each other are equally far off: then the smaller one leaves. The ratio is of
        # residuals, hence its square for chi-squares.
        suspects = [cluster for cluster, chi2 in self._results.items() if chi2 >= _SUSPECT_RATIO**2 * worst]
        out = min(suspects, key=lambda cluster: (len(self._clusters[cluster]), -self._results[cluster]))
        self.left_out[out] = self._results[out]
        del self._clusters[out]
        self._results = {}
        self._remaining = self._testable()
        return bool(self._remaining)


def _representatives(members: Sequence[int]) -> list[int]:
    """A few loops of a cluster, evenly spread."""
    chosen = np.linspace(0, len(members) - 1, min(len(members), _REPRESENTATIVES)).round()
    return [members[int(k)] for k in chosen]


def predictive_chi2_given(
    loop: LoopClosure, others: Sequence[LoopClosure], chain: OdometryChain, huber_width_sigma: float, bias: Array
) -> float:
    """Predictive chi-square of a loop against the map that odometry and other loops give.

    Args:
        loop: loop between frames.
        others: loops between frames that make the map.
        chain: odometry of all frames.
        huber_width_sigma: Huber width of the other loops, sigmas.
        bias: (6, 6) covariance of T_match_query by odometry's bias, which the graph does not model.
    """
    frames = sorted({0, loop.match, loop.query} | {k for other in others for k in (other.match, other.query)})
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(factors.prior_factor(np.eye(4)))
    for frame in frames:
        values.insert(frame, gtsam.Pose3(chain[frame]))
    for first, second in pairwise(frames):
        between = chain.between_without_bias(first, second)
        graph.add(factors.odometry_factor(first, second, between.T_first_second, between.covariance))
    for other in others:
        graph.add(factors.huber_factor(other, huber_width_sigma))
    optimizer = gtsam.GaussNewtonOptimizer(graph, values)
    for _ in range(_GAUSS_NEWTON_STEPS):
        optimizer.iterate()
    values = optimizer.values()
    joint = gtsam.Marginals(graph, values).jointMarginalCovariance([loop.match, loop.query])
    return predictive_chi2(values, joint, loop, bias)


def predictive_chi2(values: gtsam.Values, joint: gtsam.JointMarginal, loop: LoopClosure, bias: Array) -> float:
    """Chi-square of a loop against a graph that does not contain it, by the covariances of both.

    Args:
        values: solution of the graph.
        joint: joint marginal covariance of the loop's two poses.
        loop: loop between nodes of the graph.
        bias: (6, 6) covariance of T_match_query by odometry's bias, which the graph does not model.
    """
    T_world_match, T_world_query = (values.atPose3(key).matrix() for key in (loop.match, loop.query))
    T_match_query = se3.inverse(T_world_match) @ T_world_query
    # The relative pose moves with the query as it is, with the match by the adjoint.
    J = np.hstack([-se3.adjoint(se3.inverse(T_match_query)), np.eye(6)])
    ends = (loop.match, loop.query)
    predicted = J @ np.block([[joint.at(a, b) for b in ends] for a in ends]) @ J.T
    error = se3.log(se3.inverse(loop.T_match_query) @ T_match_query)
    return float(error @ np.linalg.solve(predicted + bias + loop.covariance, error))
