"""Online loop selection: which loops the map uses while frames are processed.

A loop that drift can explain may still be false, and nothing shows it at that moment. So no loop is used by itself: it
waits until a second loop of the same stretch agrees with it (pairwise consistency: Mangelson et al., ICRA 2018,
equation 3), and the map, with its uncertainty, must not exclude it. Whenever a cluster of loops has doubled, the
clusters in use, and one that the map excludes, are compared with one another by a leave-one-out test
(`slam.pose_graph.loop_clusters`). In places that the map knows well a loop locates the camera, and changes nothing else
(`slam.pose_graph.known_places`). Figures: docs/decisions/online_loop_selection.md.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from enum import Enum, auto

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from slam.loop_closing.loop_closer import LoopClosure
from slam.pose_graph.isam2 import IncrementalPoseGraph
from slam.pose_graph.known_places import KnownPlaceConfig, KnownPlaces
from slam.pose_graph.loop_clusters import LeaveOneOutTest, LoopClusterConfig, LoopClusters
from slam.pose_graph.node_chain import NodeChain
from slam.pose_graph.odometry_chain import OdometryChain
from slam.pose_graph.robust.backends import GateResult

Array = NDArray[np.float64]

# Removals of one loop: without a bound two loops that exclude each other would take turns for ever.
_MAX_REMOVALS = 3


@dataclass(frozen=True)
class LoopSelectionConfig:
    """When the online map uses a loop; chi-squares of 6 degrees of freedom.

    Attributes:
        max_inlier_chi2: maximum chi-square, by its own covariance, of a loop that agrees with the map (99.9 %).
        max_predictive_chi2: maximum chi-square, by the covariances of both, of a loop that the map does not exclude
            (99.999 %).
        clusters: settings of the clusters of loops.
        known_places: when a place is known well enough.
    """

    max_inlier_chi2: float = 22.5
    max_predictive_chi2: float = 34.0
    clusters: LoopClusterConfig = field(default_factory=LoopClusterConfig)
    known_places: KnownPlaceConfig = field(default_factory=KnownPlaceConfig)


@dataclass(frozen=True)
class LoopDecision:
    """Decision on a loop at the moment when it is proposed.

    Attributes:
        passed: whether odometry's drift can explain the loop.
        used: whether the online map uses the loop from now on.
        residual: square root of the loop's chi-square against odometry.
        reason: the decision in a sentence, with the numbers.
    """

    passed: bool
    used: bool
    residual: float
    reason: str


@dataclass(frozen=True)
class LoopEvent:
    """A change in the use of a loop by the online map.

    Attributes:
        frame: newest frame at that moment.
        loop: number of the loop, in the order in which they were added.
        used: True if the map uses the loop from now on; False if it waits or has been taken out.
        reason: the cause in a sentence, with the numbers.
    """

    frame: int
    loop: int
    used: bool
    reason: str


class _Phase(Enum):
    """Next step of the selector; an earlier phase goes before a later one."""

    SETTLE = auto()  # a step of optimisation: loops are tested against a map at rest only
    TEST = auto()  # a step of the leave-one-out test that is under way
    BEGIN_TEST = auto()  # start the leave-one-out test that is due
    RECONSIDER = auto()  # compare one cluster that was excluded with the map, as it is now
    REST = auto()


@dataclass
class _State:
    """State of the selector between two steps.

    Attributes:
        is_settling: whether the map has changed and has not come to rest.
        test: leave-one-out test under way, or None; it pauses while the map settles.
        candidate: cluster outside the map that is compared in this test, or None.
        is_test_due: whether a cluster in use has doubled since it was last tested.
        to_reconsider: clusters to compare with the map again, as it has changed.
    """

    is_settling: bool = False
    test: LeaveOneOutTest | None = None
    candidate: int | None = None
    is_test_due: bool = False
    to_reconsider: list[int] = field(default_factory=list)

    @property
    def phase(self) -> _Phase:
        if self.is_settling:
            return _Phase.SETTLE
        if self.test is not None:
            return _Phase.TEST
        if self.is_test_due:
            return _Phase.BEGIN_TEST
        return _Phase.RECONSIDER if self.to_reconsider else _Phase.REST


class OnlineLoopSelector:
    """Selects the loops that the online map uses: takes loops one by one and uses those that agree.

    Args:
        chain: odometry of all frames.
        nodes: nodes of the online graph, with the frames attached to them.
        graph: the online graph, where the selector adds and removes loops.
        config: thresholds.
    """

    def __init__(
        self, chain: OdometryChain, nodes: NodeChain, graph: IncrementalPoseGraph, config: LoopSelectionConfig
    ) -> None:
        self._chain, self._nodes, self._graph, self._config = chain, nodes, graph, config
        self._clusters = LoopClusters(chain, config.clusters)
        self._known_places = KnownPlaces(chain, nodes, graph, config.known_places)
        self._tested_sizes: dict[int, int] = {}  # size of each cluster when it was last tested
        self._removals: Counter[int] = Counter()  # of each loop, because the map contradicted it
        self._state = _State()
        self.events: list[LoopEvent] = []

    def propose(self, number: int, loop: LoopClosure, gate: GateResult) -> LoopDecision:
        """Use a loop, or let it wait.

        Args:
            number: number of the loop, in the order in which they are added.
            loop: the loop between frames, noise floor included.
            gate: test of the loop against odometry.
        """
        reason = self._assess(number, loop) if gate.passed else gate.reason
        used = self.is_used(number)
        self._log([number], used, reason)
        if used:
            self.step()
        return LoopDecision(gate.passed, used, gate.residual, reason)

    def step(self) -> None:
        """Do one step of the pending work; called once a frame, so that no frame waits for much work at once."""
        state = self._state
        if state.phase is _Phase.SETTLE:
            if self._graph.step():
                state.is_settling = self._remove_contradicted() or self._accept_waiting()
        elif state.test is not None:
            if state.test.step():
                self._apply(state.test)
        elif state.phase is _Phase.BEGIN_TEST:
            state.is_test_due = False
            self._begin_test(None)
        elif state.phase is _Phase.RECONSIDER:
            self._reconsider(state.to_reconsider.pop())

    def _assess(self, number: int, loop: LoopClosure) -> str:
        """Use a loop if the map or another loop supports it; the reason why it is used or waits."""
        if self._nodes.follow_the_same(loop.match, loop.query):
            return "waits: both frames belong to one graph node, so there is nothing to correct"
        covariance = self._nodes.loop_covariance(loop)
        (chi2,) = self._chi2([loop], [covariance])
        agrees = self._graph.has_loops and chi2 <= self._config.max_inlier_chi2
        if agrees and not self._state.is_settling and self._known_places.contain(loop.query):
            self._known_places.locate(number, loop, self._support)
            return f"joined: the map agrees, {np.sqrt(chi2):.1f} sigma, and knows the place well"
        companions = self._clusters.add(number, loop, covariance)
        if agrees:
            self._use([number])
            return f"joined: the map agrees, {np.sqrt(chi2):.1f} sigma"
        if not companions:
            return "waits: drift explains it, but no other loop of this stretch agrees yet"
        return self._assess_with(number, companions)

    def _assess_with(self, number: int, companions: list[int]) -> str:
        """Use a loop together with its cluster, unless the map excludes it."""
        chi2 = self._predictive_chi2(number) if self._graph.has_loops else 0.0
        if chi2 > self._config.max_predictive_chi2:
            return self._challenge(number, chi2)
        newcomers = [other for other in companions if not self.is_used(other)]
        self._use([number, *newcomers])
        self._log(newcomers, True, f"joined: loop {number} of this stretch agrees")
        found = f"{len(companions)} {'loops' if len(companions) > 1 else 'loop'} of this stretch"
        return f"joined: {found} and the map agree, {np.sqrt(chi2):.1f} sigma"

    def _challenge(self, number: int, chi2: float) -> str:
        """Begin to compare a cluster that the map excludes with those in use, if it has doubled since last time."""
        limit = np.sqrt(self._config.max_predictive_chi2)
        reason = f"waits: {np.sqrt(chi2):.1f} sigma from the map (limit {limit:.1f})"
        cluster = self._clusters[number].cluster
        size = len(self._clusters.members(cluster))
        if self._state.test is not None or size < 2 * self._tested_sizes.get(cluster, 1):
            return reason
        self._tested_sizes[cluster] = size
        self._begin_test(cluster)
        return f"{reason}; as {size} loops agree with it, each group is compared with the others"

    def _begin_test(self, candidate: int | None) -> None:
        """Begin to compare the clusters in use, and a candidate, with one another."""
        clusters: dict[int, list[int]] = {}
        for k in self._graph.used:
            clusters.setdefault(self._clusters[k].cluster, []).append(k)
        if candidate is not None:
            clusters[candidate] = self._clusters.members(candidate)
        self._state.candidate = candidate
        self._state.test = LeaveOneOutTest(clusters, self._clusters.chi2_given_others, self._config.max_predictive_chi2)

    def _apply(self, test: LeaveOneOutTest) -> None:
        """Remove the clusters that a test has left out, and use its candidate if it was not."""
        state, used, candidate = self._state, set(self._graph.used), self._state.candidate
        state.test = state.candidate = None
        for cluster, chi2 in test.left_out.items():
            wrong = [k for k in self._clusters.members(cluster) if k in used]
            self._remove(wrong, f"taken out: the other groups of loops put it {np.sqrt(chi2):.1f} sigma off")
            state.is_settling = state.is_settling or bool(wrong)
        if candidate is not None and candidate not in test.left_out:
            members = [k for k in self._clusters.members(candidate) if k not in used]
            self._use(members)
            self._log(members, True, f"joined: {len(members)} loops outweigh those against them")
        if state.is_settling:
            state.to_reconsider = [cluster for cluster in self._clusters.names if cluster != candidate]

    def _reconsider(self, cluster: int) -> None:
        """Use a cluster that the map has excluded, if it no longer does."""
        used = set(self._graph.used)
        waiting = [k for k in self._clusters.members(cluster) if k not in used]
        if len(waiting) < 2 or not used:
            return
        chi2 = self._predictive_chi2(waiting[len(waiting) // 2])
        if chi2 <= self._config.max_predictive_chi2:
            self._use(waiting)
            self._log(waiting, True, f"joined: {np.sqrt(chi2):.1f} sigma from the map by now")

    def _use(self, numbers: Iterable[int]) -> None:
        """Add loops to the map; a cluster that has doubled by them makes a test due."""
        loops = {k: self._clusters[k].loop for k in numbers}
        self._known_places.add_nodes(max(loop.query for loop in loops.values()))
        between_nodes = {k: self._nodes.between_nodes(loop) for k, loop in loops.items()}
        self._graph.add_loops({k: loop for k, loop in between_nodes.items() if loop is not None})
        self._state.is_settling = True
        for cluster in sorted({self._clusters[k].cluster for k in numbers}):
            size = len(self._clusters.members(cluster))
            if size >= 2 * self._tested_sizes.get(cluster, 1):
                self._tested_sizes[cluster], self._state.is_test_due = size, True

    def _remove_contradicted(self) -> bool:
        """Remove the used loops that are furthest from the map; whether there were any.

        Only those beyond half of the largest chi-square: the others may agree when these are gone.
        """
        used = self._graph.used
        chi2 = self._graph.chi2(used)
        limit = max(self._config.max_inlier_chi2, 0.5 * float(chi2.max(initial=0.0)))
        wrong = [used[k] for k in np.flatnonzero(chi2 > limit)]
        self._removals.update(wrong)
        self._remove(wrong, f"taken out: over {np.sqrt(limit):.1f} sigma from the map that the others make")
        if len(used) - len(wrong) == 1:
            self._remove(set(used) - set(wrong), "taken out: no other loop agrees any more")
            return True
        return bool(wrong)

    def _accept_waiting(self) -> bool:
        """Use the waiting loops that the map now agrees with; whether there were any."""
        numbers = self._clusters.numbers if self._graph.has_loops else []
        used = set(self._graph.used)
        waiting = [k for k in numbers if k not in used and self._removals[k] < _MAX_REMOVALS]
        chi2 = self._chi2_of(waiting)
        agree = [k for k, value in zip(waiting, chi2, strict=True) if value <= self._config.max_inlier_chi2]
        agree = [k for k in agree if self._nodes.between_nodes(self._clusters[k].loop) is not None]
        if agree:
            self._use(agree)
        self._log(agree, True, "joined: the map agrees by now")
        return bool(agree)

    def _remove(self, numbers: Iterable[int], reason: str) -> None:
        """Stop using loops, and locate no frame any more by what rested on them alone."""
        numbers = sorted(numbers)
        self._graph.remove_loops(numbers)
        self._log(numbers, False, reason)
        lost = self._known_places.undo_unsupported(set(self._graph.used)) if numbers else {}
        self._log(lost, False, "taken out: the loops that led to this place are out")
        for number, loop in lost.items():
            self._clusters.add(number, loop, self._nodes.loop_covariance(loop))

    def _support(self, frame: int) -> frozenset[int]:
        """Numbers of the loops in use that tie the camera to the map: those of the last stretch up to a frame."""
        path = {k: self._chain.path_length_m(self._clusters[k].loop.query) for k in self._graph.used}
        path = {k: length for k, length in path.items() if length <= self._chain.path_length_m(frame)}
        start = max(path.values(), default=0.0) - self._config.clusters.max_distance_m
        return frozenset(k for k, length in path.items() if length >= start)

    def is_used(self, number: int) -> bool:
        """Whether the online map uses a loop: as an edge, or to locate the camera in a known place."""
        return self._graph.uses(number) or self._known_places.uses(number)

    def _chi2_of(self, numbers: Sequence[int]) -> Array:
        """(L,) chi-square of loops at the map, by their own covariances alone."""
        loops = [self._clusters[number] for number in numbers]
        return self._chi2([known.loop for known in loops], [known.covariance for known in loops])

    def _chi2(self, loops: Sequence[LoopClosure], covariances: Sequence[Array]) -> Array:
        """(L,) chi-square of loops between frames at the map, by covariances (6, 6)."""
        if not loops:
            return np.zeros(0)
        ends = np.array([*(loop.match for loop in loops), *(loop.query for loop in loops)])
        nodes, T_node_frames = self._nodes.places_of(ends)
        T_world_match, T_world_query = np.split(self._graph.poses_of(nodes.tolist()) @ T_node_frames, 2)
        measured = np.array([loop.T_match_query for loop in loops])
        errors = se3.log(se3.inverse(measured) @ se3.inverse(T_world_match) @ T_world_query)
        whitened = np.linalg.solve(np.array(covariances), errors[..., None])[..., 0]
        return np.asarray(np.sum(errors * whitened, axis=1))

    def _predictive_chi2(self, number: int) -> float:
        """Chi-square of a loop against the map, the covariances of both counted."""
        loop = self._clusters[number].loop
        self._known_places.add_nodes(loop.query)
        between_nodes = self._nodes.between_nodes(loop)
        if between_nodes is None:  # both frames were located on one node since
            return float(self._chi2_of([number])[0])
        return self._graph.predictive_chi2(between_nodes, self._clusters.bias_covariance(number, self._graph.used))

    def _log(self, numbers: Iterable[int], used: bool, reason: str) -> None:
        self.events += [LoopEvent(len(self._chain) - 1, number, used, reason) for number in numbers]
