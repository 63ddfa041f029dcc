"""Several sessions in one map: alignment of a new session with the earlier ones, and one pose graph of all.

No motion is measured from the end of one session to the beginning of the next. The loops between them give it: each
tells where the new session began in the frame of the earlier ones. Where enough of them agree, the chains of odometry
are joined by an edge with a covariance that covers the error that these loops may have in common. From then on all
sessions are one chain, and the back ends decide on all loops alike.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from slam.loop_closing import LoopClosure
from slam.pose_graph import PoseGraph, PoseGraphConfig
from slam.robust import OptimizationResult

Array = NDArray[np.float64]
Step = tuple[Array, Array]  # T_previous_current (4, 4), metres, and its covariance (6, 6), rotation first


@dataclass(frozen=True)
class SessionAlignmentConfig:
    """When the loops between sessions agree on where the new session began.

    Attributes:
        max_distance_m: maximum distance between the positions that two agreeing loops give, metres,
        max_drift: and the part of the path length between them that is added to it, and to the angle in degrees.
        max_angle_deg: maximum angle between the orientations that two agreeing loops give, degrees.
        min_loops: minimum number of loops that agree.
        min_path_length_m: minimum path length between the first and the last of them, metres: neighbouring images
            have errors in common.
        sigma_rad, sigma_m: standard deviation of the edge between two sessions.
    """

    max_distance_m: float = 2.0
    max_drift: float = 0.02
    max_angle_deg: float = 5.0
    min_loops: int = 5
    min_path_length_m: float = 5.0
    sigma_rad: float = 0.1
    sigma_m: float = 10.0

    @property
    def covariance(self) -> Array:
        """Covariance (6, 6) of the edge between two sessions."""
        return np.diag(np.repeat(np.square([self.sigma_rad, self.sigma_m]), 3))


@dataclass(frozen=True)
class SessionTrajectory:
    """Odometry and poses of one session.

    Attributes:
        steps: (N - 1) motions with their covariances.
        poses: (N, 4, 4) current poses, in the frame of the session or of the map.
    """

    steps: tuple[Step, ...]
    poses: Array


@dataclass(frozen=True)
class MergedSessions:
    """Several sessions in one frame.

    Attributes:
        poses: T_map_camera (N, 4, 4) of all images of all sessions in their order.
        optimized: result of the back end, loops in the order in which they were given.
        T_map_session: (4, 4) the first camera of the last session.
    """

    poses: Array
    optimized: OptimizationResult
    T_map_session: Array = field(default_factory=lambda: np.eye(4))


def align_sessions(
    earlier: Array, own: Array, loops: Sequence[LoopClosure], config: SessionAlignmentConfig | None = None
) -> Array | None:
    """Where a session began in the frame of earlier ones, T_map_session (4, 4); None where its loops do not agree.

    Args:
        earlier: T_map_camera (M, 4, 4) of the earlier sessions.
        own: T_session_camera (N, 4, 4) of the new session.
        loops: between them; `match` counts from the first earlier image, `query` from the first of the new session.
        config: when loops agree.
    """
    config = config or SessionAlignmentConfig()
    if len(loops) < config.min_loops:
        return None
    queries = np.array([loop.query for loop in loops])
    proposed = np.array([earlier[loop.match] @ loop.T_match_query @ se3.inverse(own[loop.query]) for loop in loops])
    positions = own[queries, :3, 3]
    distances = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(own[:, :3, 3], axis=0), axis=1))])[queries]
    # Compared at the images of the queries, not where the session began: there a small angle moves them far.
    # Where loop k places the image of loop l, (K, K, 3):
    placed = np.einsum("kij,lj->kli", proposed[:, :3, :3], positions) + proposed[:, None, :3, 3]
    apart = np.linalg.norm(placed - np.einsum("llj->lj", placed)[None], axis=2)
    distance_between = np.abs(distances[:, None] - distances)
    angles = np.degrees(_angles(proposed))
    drift = config.max_drift * distance_between
    agree = (apart <= config.max_distance_m + drift) & (angles <= config.max_angle_deg + drift)
    best = int(agree.sum(axis=1).argmax())
    agreeing = np.flatnonzero(agree[best])
    if len(agreeing) < config.min_loops or np.ptp(distances[agreeing]) < config.min_path_length_m:
        return None
    return np.asarray(proposed[best])


def _angles(poses: Array) -> Array:
    """Angles (K, K), radians, between the rotations of poses (K, 4, 4)."""
    traces = np.einsum("kij,lij->kl", poses[:, :3, :3], poses[:, :3, :3])
    angles: Array = np.arccos(np.clip((traces - 1.0) / 2.0, -1.0, 1.0))
    return angles


def merge_sessions(
    sessions: Sequence[SessionTrajectory], loops: Sequence[LoopClosure], graph: PoseGraphConfig, robust: str,
    config: SessionAlignmentConfig | None = None,
) -> MergedSessions:  # fmt: skip
    """Optimise several sessions in one pose graph.

    Args:
        sessions: in their order, their poses in one frame as far as it is known.
        loops: within and between them, with images counted from the first of the first session.
        graph: noise model of odometry and loops.
        robust: name of a back end.
        config: standard deviation of the edge from one session to the next.
    """
    config = config or SessionAlignmentConfig()
    whole = PoseGraph(graph)
    for number, session in enumerate(sessions):
        if number:
            T_last_first = se3.inverse(sessions[number - 1].poses[-1]) @ session.poses[0]
            whole.add_odometry(T_last_first, config.covariance)
        for T_previous_current, covariance in session.steps:
            whole.add_odometry(T_previous_current, covariance)
    for loop in loops:
        whole.add_loop(loop)
    optimized = whole.optimize(robust)
    begin = sum(len(session.poses) for session in sessions[:-1])
    return MergedSessions(optimized.poses, optimized, optimized.poses[begin])
