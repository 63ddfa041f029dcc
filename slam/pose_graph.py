"""The pose graph: every frame a node, odometry its chain, loops its shortcuts.

Online with iSAM2 (Kaess et al., IJRR 2012), and at the end a robust batch that judges every loop again.
"""

import time
from dataclasses import dataclass, field, replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from odometry import se3
from slam import pose_graph_solver as solver
from slam import robust as robust_ends
from slam.errors import GraphError
from slam.loop_closing import LoopClosure
from slam.loop_trust import Admission, Change, LoopTrust, TrustConfig
from slam.pose_graph_drift import DriftBudget, OdometryChain, chained
from slam.pose_graph_edges import stacked
from slam.pose_graph_keys import KeyChain, KeySpacing
from slam.pose_graph_marginals import marginal_covariances
from slam.pose_graph_online import IncrementalConfig, IncrementalMap
from slam.pose_graph_units import corrected, levelled
from slam.robust import LoopGate, Optimized
from slam.scale_levels import unit_logs

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PoseGraphConfig:
    """What the graph believes about odometry and loops."""

    drift: DriftBudget = field(default_factory=DriftBudget)  # how wrong odometry may be over a distance
    unit_drift: float = 0.0  # growth of the logarithm of its unit of length, for a square root of a metre
    # Added to every loop: one stated to be exact bends odometry round itself, be it true or false.
    loop_sigma_rad: float = 2e-3  # of rotation, radians
    loop_sigma_m: float = 0.05  # of translation, metres
    gate_chi2: float = 34.0  # 99.999 % of 6 dof: a loop further from odometry than this is none
    inlier_chi2: float = 22.5  # 99.9 % of 6 dof: a loop further from the optimised map than this is false
    keys: KeySpacing = field(default_factory=KeySpacing)  # which frames are optimised online
    trust: TrustConfig = field(default_factory=TrustConfig)  # which loops the online map leans on
    online: IncrementalConfig = field(default_factory=IncrementalConfig)

    def softened(self, closure: LoopClosure) -> LoopClosure:
        """Give a loop the covariance that the graph believes."""
        floor = np.diag(np.repeat(np.square([self.loop_sigma_rad, self.loop_sigma_m]), 3))
        return replace(closure, covariance=closure.covariance + floor)


class PoseGraph:
    """Frames with their odometry and loops; frame 0 stays at the identity.

    All poses are T_world_camera in metres; covariances (6, 6) belong to right perturbations, rotation first.
    """

    def __init__(self, config: PoseGraphConfig | None = None) -> None:
        self.config = config or PoseGraphConfig()
        self._chain = OdometryChain(self.config.drift)
        self._motions = gtsam.NonlinearFactorGraph()
        self._motions.add(solver.anchor(np.eye(4)))
        self._edges: list[tuple[Array, Array]] = []
        self._loops: list[LoopClosure] = []
        self._gates: list[LoopGate] = []
        self._keys = KeyChain(self.config.keys)
        self._map = IncrementalMap(self.config.online)
        self._trust = LoopTrust(self._chain, self._keys, self._map, self.config.trust)

    def __len__(self) -> int:
        return len(self._chain)

    @property
    def loops(self) -> tuple[LoopClosure, ...]:
        """All loops as they were added and in that order, gated out or not: the batch may reconsider them."""
        return tuple(self._loops)

    @property
    def gates(self) -> tuple[LoopGate, ...]:
        """The gate's verdict on each of `loops`."""
        return tuple(self._gates)

    @property
    def odometry(self) -> tuple[tuple[Array, Array], ...]:
        """(N - 1) motions T_previous_current (4, 4) with their stated covariances (6, 6)."""
        return tuple(self._edges)

    def add_odometry(self, T_previous_current: Array, covariance: Array) -> None:
        """Add the next frame by its motion (4, 4), metres, and covariance (6, 6).

        Raises:
            GraphError: the covariance is not finite and positive definite.
        """
        stated = _checked(covariance, f"motion to frame {len(self)}")
        real = self.config.drift.of_motion(T_previous_current, stated)
        self._motions.add(solver.odometry_factor(len(self) - 1, len(self), T_previous_current, real))
        self._edges.append((T_previous_current, covariance))
        self._chain.append(T_previous_current, stated)
        key = self._keys.append(T_previous_current, real)
        if key is not None:
            self._map.add_key(key.T_key_frame, key.covariance)
        self._trust.review()

    def add_loop(self, closure: LoopClosure) -> Admission:
        """Judge a loop against odometry's drift and against the loops so far; the online map may lean on it.

        Raises:
            GraphError: a frame is not in the graph, or the covariance is not positive definite.
        """
        self._check(closure)
        soft = self.config.softened(closure)
        gate = self._gate(soft)
        self._loops.append(closure)
        self._gates.append(gate)
        return self._trust.offer(len(self._loops) - 1, soft, gate)

    def latest(self) -> Array:
        """T_world_camera (4, 4) of the newest frame by all that is known now."""
        return self._map.T_world_newest @ self._keys[len(self) - 1].T_key_frame

    def poses(self) -> Array:
        """T_world_camera (N, 4, 4) of all frames by all that is known now."""
        return self._keys.poses(self._map.poses())

    @property
    def history(self) -> tuple[Change, ...]:
        """What became of the loops online, as it happened."""
        return tuple(self._trust.history)

    def odometry_poses(self) -> Array:
        """T_world_camera (N, 4, 4) by odometry alone."""
        return self._chain.poses

    def odometry_covariances(self) -> Array:
        """Covariances (N, 6, 6) of odometry's poses, drift budget included; frame 0 is held."""
        return self._chain.covariances()

    def covariances(self, optimized: Optimized) -> Array:
        """Covariances (N, 6, 6) of the poses that an optimisation has led to, by the loops that it kept."""
        graph = gtsam.NonlinearFactorGraph()
        graph.push_back(self._motions)
        for number in np.flatnonzero(optimized.kept):
            graph.add(solver.loop_factor(self.config.softened(self._loops[number])))
        return marginal_covariances(graph, optimized.poses, self._chain.lasting_sigmas())

    def optimize(self, robust: str = robust_ends.DEFAULT) -> Optimized:
        """Optimise everything at once under a robust back end of `slam.robust.BACK_ENDS`.

        Raises:
            ConfigError: the name is not known.
        """
        start = time.perf_counter()
        units = self._units()
        outcome = robust_ends.solved(self._problem(units), robust)
        poses, units = self._with_scale(outcome, units)
        problem = self._problem(units)
        return Optimized(
            poses=poses,
            weights=outcome.weights,
            residuals=np.sqrt(problem.loops.chi2(poses)),
            kept=outcome.kept,
            reasons=outcome.reasons,
            error_initial=problem.error(outcome.kept, problem.start),
            error_final=problem.error(outcome.kept, poses),
            seconds=time.perf_counter() - start,
            units=units,
        )

    def _units(self) -> Array:
        """Unit of length (N,) of each frame in that of the first, by what the loops tell."""
        steps = np.array([np.linalg.norm(T[:3, 3]) for T, _ in self._edges])
        return np.exp(unit_logs(steps, self._loops, self.config.unit_drift))

    def _with_scale(self, outcome: robust_ends.Outcome, units: Array) -> tuple[Array, Array]:
        """Poses and units after the last word of the kept loops: with one camera they correct both together."""
        kept = [loop for loop, keep in zip(self._loops, outcome.kept, strict=True) if keep]
        if not self.config.unit_drift or not kept:
            return outcome.poses, units
        real = [(T, self.config.drift.of_motion(T, covariance)) for T, covariance in self._edges]
        soft = [self.config.softened(loop) for loop in kept]
        return corrected(real, soft, outcome.poses, units, self.config.unit_drift)

    def levelled(self, units: Array) -> tuple[list[tuple[Array, Array]], list[LoopClosure]]:
        """Motions with their covariances, and loops, in one unit, of which each frame's is so much, (N,)."""
        return levelled(self._edges, self._loops, units)

    def _problem(self, units: Array) -> robust_ends.LoopProblem:
        edges, closures = self.levelled(units)
        real = [(T, self.config.drift.of_motion(T, covariance)) for T, covariance in edges]
        soft = [self.config.softened(loop) for loop in closures]
        before, ends = np.arange(len(real)), [(loop.match, loop.query) for loop in soft]
        chain = stacked(np.column_stack([before, before + 1]), real)
        loops = stacked(np.array(ends), [(loop.T_match_query, loop.covariance) for loop in soft])
        return robust_ends.LoopProblem(chain, loops, chained([T for T, _ in edges]))

    def _check(self, closure: LoopClosure) -> None:
        if not 0 <= closure.match < closure.query < len(self):
            raise GraphError(
                f"loop {closure.query} -> {closure.match}: expected an earlier frame and a later one among "
                f"the {len(self)} in the graph; add the odometry of both frames first"
            )
        _checked(closure.covariance, f"loop {closure.query} -> {closure.match}")

    def _gate(self, closure: LoopClosure) -> LoopGate:
        between = self._chain.between(closure.match, closure.query)
        difference = se3.inverse(closure.T_match_query) @ between.T_first_second
        error = se3.log(difference)
        residual = float(np.sqrt(error @ np.linalg.solve(between.covariance + closure.covariance, error)))
        passed = residual**2 <= self.config.gate_chi2
        verdict = "drift explains" if passed else "drift does not explain"
        distance, angle = np.linalg.norm(difference[:3, 3]), np.degrees(se3.angle(difference))
        reason = (
            f"{verdict} {distance:.1f} m and {angle:.1f} deg over {between.way:.0f} m of way: "
            f"{residual:.1f} sigma (limit {np.sqrt(self.config.gate_chi2):.1f})"
        )
        return LoopGate(passed, residual, reason)


def _checked(covariance: Array, name: str) -> Array:
    """Pass a covariance (6, 6) on if it is one."""
    good = np.shape(covariance) == (6, 6) and np.isfinite(covariance).all()
    if not good or np.linalg.eigvalsh(covariance)[0] <= 0:
        raise GraphError(f"{name}: expected a finite, positive definite covariance (6, 6), got {covariance}")
    return covariance
