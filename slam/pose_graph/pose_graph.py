"""The pose graph: frames are nodes, odometry is a chain of edges, loops are edges that shorten it.

Online with iSAM2 (Kaess et al., IJRR 2012) on some of the frames, and at the end a robust batch optimisation of all
frames that decides on every loop again.
"""

import time
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from slam.errors import GraphError
from slam.loop_closing.loop_closer import LoopClosure
from slam.pose_graph.isam2 import IncrementalConfig, IncrementalPoseGraph
from slam.pose_graph.node_chain import NodeChain, NodeSpacing
from slam.pose_graph.odometry_chain import OdometryChain, OdometryDriftModel, RelativeMotion, chain_motions
from slam.pose_graph.online_loop_selection import LoopDecision, LoopEvent, LoopSelectionConfig, OnlineLoopSelector
from slam.pose_graph.optimization.edges import from_measurements
from slam.pose_graph.optimization.lie_groups import rigid_and_scale
from slam.pose_graph.optimization.marginals import marginal_covariances
from slam.pose_graph.optimization.sim3 import (
    in_common_scale,
    scale_variances,
    similarity_loops,
    similarity_motions,
)
from slam.pose_graph.robust import backends as back_ends
from slam.pose_graph.robust.backends import GateResult, OptimizationResult
from slam.pose_graph.robust.problem import OnlineMap, condensed_covariances

Array = NDArray[np.float64]

# Of the covariances: GTSAM's time grows with the laps, to 21 s for 3,000 frames of ten laps, which take 0.3 s without.
_MAX_GTSAM_POSES = 1000


@dataclass(frozen=True)
class PoseGraphConfig:
    """Noise of odometry and loops, and the frames and loops of the online graph.

    Attributes:
        drift: errors of odometry beyond its stated covariance.
        scale_drift: standard deviation of the log scale over a metre; it grows with the root of the path length.
        loop_sigma_rad, loop_sigma_m: noise floor added to every loop, rotation and translation: a loop with too small
            a covariance would bend odometry around itself.
        max_gate_chi2: maximum chi-square (6 degrees of freedom, 99.999 %) of a loop that drift can explain.
        nodes: selection of the frames that are optimised online.
        loop_selection: selection of the loops that are used online.
        incremental: settings of iSAM2.
    """

    drift: OdometryDriftModel = field(default_factory=OdometryDriftModel)
    scale_drift: float = 0.0
    loop_sigma_rad: float = 2e-3
    loop_sigma_m: float = 0.05
    max_gate_chi2: float = 34.0
    nodes: NodeSpacing = field(default_factory=NodeSpacing)
    loop_selection: LoopSelectionConfig = field(default_factory=LoopSelectionConfig)
    incremental: IncrementalConfig = field(default_factory=IncrementalConfig)

    def with_noise_floor(self, closure: LoopClosure) -> LoopClosure:
        """A loop with `loop_sigma_rad` and `loop_sigma_m` added to its covariance."""
        floor = np.diag(np.repeat(np.square([self.loop_sigma_rad, self.loop_sigma_m]), 3))
        return replace(closure, covariance=closure.covariance + floor)


class PoseGraph:
    """Frames with their odometry and loops; frame 0 stays at the identity.

    All poses are T_world_camera in metres; covariances (6, 6) belong to right perturbations, rotation first.
    """

    def __init__(self, config: PoseGraphConfig | None = None) -> None:
        self.config = config or PoseGraphConfig()
        self._chain = OdometryChain(self.config.drift)
        self._edges: list[tuple[Array, Array]] = []
        self._loops: list[LoopClosure] = []
        self._gates: list[GateResult] = []
        self._last_used: int | None = None  # number of the last loop that the online map has used at once
        self._nodes = NodeChain(self._chain, self.config.nodes)
        self._incremental = IncrementalPoseGraph(self.config.incremental)
        self._selector = OnlineLoopSelector(self._chain, self._nodes, self._incremental, self.config.loop_selection)

    def __len__(self) -> int:
        return len(self._chain)

    @property
    def loops(self) -> tuple[LoopClosure, ...]:
        """All loops in the order in which they were added, also those that failed the gate: the batch decides again."""
        return tuple(self._loops)

    @property
    def gates(self) -> tuple[GateResult, ...]:
        """The gate's result for each of `loops`."""
        return tuple(self._gates)

    @property
    def odometry(self) -> tuple[tuple[Array, Array], ...]:
        """(N - 1) motions T_previous_current (4, 4) with their stated covariances (6, 6)."""
        return tuple(self._edges)

    def add_odometry(self, T_previous_current: Array, covariance: Array) -> None:
        """Add the next frame by its motion.

        Args:
            T_previous_current: (4, 4) camera of the new frame in that of the frame before, metres.
            covariance: (6, 6) of its right perturbation, rotation first.

        Raises:
            GraphError: the covariance is not finite and positive definite.
        """
        stated = _check_covariance(covariance, f"motion to frame {len(self)}")
        self._edges.append((T_previous_current, covariance))
        self._chain.append(T_previous_current, stated)
        self._nodes.append()
        self._selector.step()

    def add_loop(self, closure: LoopClosure) -> LoopDecision:
        """Add a loop: test it against odometry's drift and against the loops so far, and use it online if it agrees.

        Raises:
            GraphError: a frame is not in the graph, or the covariance is not positive definite.
        """
        self._check(closure)
        floored = self.config.with_noise_floor(closure)
        gate = self._gate(floored)
        self._loops.append(closure)
        self._gates.append(gate)
        decision = self._selector.propose(len(self._loops) - 1, floored, gate)
        if decision.used:
            self._last_used = len(self._loops) - 1
        return decision

    def current_pose(self) -> Array:
        """T_world_camera (4, 4) of the newest frame, by odometry and the loops in use."""
        (node,), (T_node_frame,) = self._nodes.places_of(np.array([len(self) - 1]))
        return self._incremental.pose(int(node)) @ T_node_frame

    def poses(self) -> Array:
        """T_world_camera (N, 4, 4) of all frames, by odometry and the loops in use."""
        return self._nodes.poses(self._incremental.poses())

    @property
    def loop_events(self) -> tuple[LoopEvent, ...]:
        """Online decisions on the loops, in the order in which they were made."""
        return tuple(self._selector.events)

    def odometry_poses(self) -> Array:
        """T_world_camera (N, 4, 4) by odometry alone."""
        return self._chain.poses

    def odometry_covariances(self) -> Array:
        """Covariances (N, 6, 6) of odometry's poses, drift model included; frame 0 is held."""
        return self._chain.covariances()

    def covariances(self, optimized: OptimizationResult) -> Array:
        """Covariances (N, 6, 6) of the poses of an optimisation, by odometry and the loops that it kept.

        Beyond 1,000 frames they are computed for the frames of loops and some others, and interpolated; on a very long
        drive for a few hundred.
        """
        edges, closures = self.in_common_scale(optimized.scales)
        loops = [self.config.with_noise_floor(closures[number]) for number in np.flatnonzero(optimized.kept)]
        motions, bias_sigmas = self._with_drift(edges), self._chain.bias_sigmas()
        if len(self) <= _MAX_GTSAM_POSES:
            return marginal_covariances(motions, loops, optimized.poses, bias_sigmas)
        errors = bias_sigmas[:, :, None] * np.eye(6)
        return condensed_covariances(_edges_of(motions, loops, optimized.poses), errors)

    @property
    def num_online_nodes(self) -> int:
        """Number of nodes of the online graph; the other frames are attached to these."""
        return self._incremental.num_nodes

    @property
    def num_online_loops(self) -> int:
        """Number of loops that are edges of the online graph."""
        return len(self._incremental.used)

    def optimize(self, robust: str = back_ends.DEFAULT) -> OptimizationResult:
        """Optimise all frames and loops at once with a robust back end of `slam.pose_graph.robust.backends.BACK_ENDS`.

        Raises:
            ConfigError: there is no back end of this name.
        """
        start = time.perf_counter()
        problem = self._problem()
        result = back_ends.solve(problem, robust)
        poses, scales = rigid_and_scale(result.poses) if self.config.scale_drift else (result.poses, np.ones(len(self)))
        return OptimizationResult(
            poses=poses,
            weights=result.weights,
            residuals=np.sqrt(problem.loops.chi2(result.poses)),
            kept=result.kept,
            reasons=result.reasons,
            error_initial=problem.error(result.kept, problem.start),
            error_final=problem.error(result.kept, result.poses),
            seconds=time.perf_counter() - start,
            scales=scales,
        )

    def in_common_scale(self, scales: Array) -> tuple[list[tuple[Array, Array]], list[LoopClosure]]:
        """Motions with their covariances, and loops, in one unit of length, by the scales (N,) of the frames."""
        return in_common_scale(self._edges, self._loops, scales)

    def _with_drift(self, edges: list[tuple[Array, Array]]) -> list[tuple[Array, Array]]:
        """Motions with the random walk of the drift model added to their covariances."""
        return [(T, self.config.drift.of_motion(T, covariance)) for T, covariance in edges]

    def _problem(self) -> back_ends.LoopProblem:
        """Rigid motions, or similarities where the scale drifts."""
        motions, floored = self._with_drift(self._edges), [self.config.with_noise_floor(loop) for loop in self._loops]
        poses, drift = chain_motions([T for T, _ in self._edges]), self.config.scale_drift
        if not drift:
            used = np.array([self._selector.is_used(number) for number in range(len(self._loops))], dtype=bool)
            return replace(_edges_of(motions, floored, poses), online=OnlineMap(self.poses(), used))
        chain = similarity_motions(motions, scale_variances(self._edges, drift))
        return back_ends.LoopProblem(chain, similarity_loops(floored), poses)

    def _check(self, closure: LoopClosure) -> None:
        if not 0 <= closure.match < closure.query < len(self):
            raise GraphError(
                f"loop {closure.query} -> {closure.match}: expected an earlier frame and a later one among "
                f"the {len(self)} in the graph; add the odometry of both frames first"
            )
        _check_covariance(closure.covariance, f"loop {closure.query} -> {closure.match}")

    def _gate(self, closure: LoopClosure) -> GateResult:
        """Test a loop against odometry since its match; if that drifts too far, since the last loop in use.

        Errors of odometry that each lap repeats add up to more than the drift model explains. But the map knows where
        the camera was a moment ago.
        """
        gate = self._compare(closure, self._chain.between(closure.match, closure.query))
        last = self._last_used
        if gate.passed or last is None or not self._selector.is_used(last):
            return gate
        again = self._compare(closure, self._motion_through(self.config.with_noise_floor(self._loops[last]), closure))
        return again if again.passed else gate

    def _motion_through(self, used: LoopClosure, closure: LoopClosure) -> RelativeMotion:
        """From a loop's match to its query by odometry to the match of a loop in use, that loop, and odometry again."""
        before = self._chain.between(closure.match, used.match)
        after = self._chain.between(used.query, closure.query)
        T_match_used = before.T_first_second @ used.T_match_query
        covariance = se3.compose_covariance(before.covariance, used.T_match_query, used.covariance)
        return RelativeMotion(
            T_match_used @ after.T_first_second,
            se3.compose_covariance(covariance, after.T_first_second, after.covariance),
            before.path_length_m + after.path_length_m,
        )

    def _compare(self, closure: LoopClosure, between: RelativeMotion) -> GateResult:
        """Test a loop against a relative pose that odometry gives, with the covariances of both."""
        difference = se3.inverse(closure.T_match_query) @ between.T_first_second
        error = se3.log(difference)
        residual = float(np.sqrt(error @ np.linalg.solve(between.covariance + closure.covariance, error)))
        passed = residual**2 <= self.config.max_gate_chi2
        verb = "drift explains" if passed else "drift does not explain"
        distance, angle = np.linalg.norm(difference[:3, 3]), np.degrees(se3.angle(difference))
        reason = (
            f"{verb} {distance:.1f} m and {angle:.1f} deg over {between.path_length_m:.0f} m of path: "
            f"{residual:.1f} sigma (limit {np.sqrt(self.config.max_gate_chi2):.1f})"
        )
        return GateResult(passed, residual, reason)


def _edges_of(motions: list[tuple[Array, Array]], loops: list[LoopClosure], poses: Array) -> back_ends.LoopProblem:
    """The problem of N - 1 motions with their covariances, of loops, and of poses (N, 4, 4) to start from."""
    before, ends = np.arange(len(motions)), [(loop.match, loop.query) for loop in loops]
    chain = from_measurements(np.column_stack([before, before + 1]), motions)
    measured = from_measurements(np.array(ends), [(loop.T_match_query, loop.covariance) for loop in loops])
    return back_ends.LoopProblem(chain, measured, poses)


def _check_covariance(covariance: Array, name: str) -> Array:
    """The covariance (6, 6) itself; GraphError if it is not finite and positive definite."""
    good = np.shape(covariance) == (6, 6) and np.isfinite(covariance).all()
    if not good or np.linalg.eigvalsh(covariance)[0] <= 0:
        raise GraphError(f"{name}: expected a finite, positive definite covariance (6, 6), got {covariance}")
    return covariance
