"""The end of a session: its trajectory is corrected alone, or merged with the earlier sessions to which it has loops.

No motion is measured from the end of one session to the beginning of the next. The loops between them give it: each
loop tells where the new session began in the frame of the earlier ones. Where enough of them agree, the chains of
odometry are joined by an edge with a covariance that covers the error that these loops may have in common. From then
on all sessions are one chain, and the back ends decide on all loops alike.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from slam.config import RunConfig
from slam.loop_closing.loop_closer import LoopClosure
from slam.map_database.database import LoopOutcome, MapDatabase, OptimizedSession, Session
from slam.pose_graph.pose_graph import PoseGraph, PoseGraphConfig
from slam.pose_graph.robust.backends import OptimizationResult

Array = NDArray[np.float64]
Images = NDArray[np.int64]
Step = tuple[Array, Array]  # T_previous_current (4, 4), metres, and its covariance (6, 6), rotation first


@dataclass(frozen=True)
class SessionAlignmentConfig:
    """When the loops between sessions agree on where the new session began.

    Attributes:
        max_distance_m: maximum distance between the positions that two agreeing loops give, metres.
        max_drift_ratio: share of the path length between the two loops by which that distance, and the angle in
            degrees, may be larger.
        max_angle_deg: maximum angle between the orientations that two agreeing loops give, degrees.
        min_loops: minimum number of loops that agree.
        min_path_length_m: minimum path length between the first and the last of them, metres: neighbouring images
            have errors in common.
        sigma_rad, sigma_m: standard deviation of the edge between two sessions.
    """

    max_distance_m: float = 2.0
    max_drift_ratio: float = 0.02
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
    """Start T_map_session (4, 4) of a session in the frame of earlier ones; None if its loops do not agree.

    Args:
        earlier: T_map_camera (M, 4, 4) of the earlier sessions.
        own: T_session_camera (N, 4, 4) of the new session.
        loops: loops between them; `match` counts from the first earlier image, `query` from the first own one.
        config: settings of the agreement.
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
    drift = config.max_drift_ratio * distance_between
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


@dataclass(frozen=True)
class MergeResult:
    """What became of a session in a map of other sessions.

    Attributes:
        joined: whether it is in one frame of reference with some of them.
        verified: number of loops to their images with a relative pose.
        kept: number of those in the corrected graph.
        sessions: numbers of the sessions with which it was merged.
        T_map_session: (4, 4) its first camera in their frame; the identity where it was not merged.
    """

    joined: bool = False
    verified: int = 0
    kept: int = 0
    sessions: tuple[int, ...] = ()
    T_map_session: Array = field(default_factory=lambda: np.eye(4))


@dataclass(frozen=True)
class SessionResult:
    """The end of a session.

    Attributes:
        optimized: its trajectory in its own frame, and the decisions on its own loops.
        merge: what became of it in a map of other sessions; None where there are none.
    """

    optimized: OptimizationResult
    merge: MergeResult | None = None


@dataclass(frozen=True)
class NumberedLoop:
    """A verified loop of a map database.

    Attributes:
        number: number of its record.
        loop: query and match by the numbers of images in the map.
    """

    number: int
    loop: LoopClosure


def close_session(session: Session, optimized: OptimizationResult) -> tuple[OptimizedSession, SessionResult]:
    """Close a session that was interrupted: its poses for the map, and its result.

    No decision on a loop is kept, since the session may be resumed.
    """
    return _by_itself(session, optimized, []), SessionResult(optimized)


def merge_session(
    store: MapDatabase, session: Session, optimized: OptimizationResult, config: RunConfig
) -> tuple[OptimizedSession, SessionResult]:
    """Close a session that has come to its end, merged with the sessions that its loops lead to.

    Args:
        store: database with all frames and loops of the session.
        session: the session.
        optimized: result of the session by itself.
        config: settings of the run.

    Returns:
        Poses and loop decisions for the map, and the result for the run.
    """
    loops = verified_loops(store)
    own = [numbered for numbered in loops if numbered.loop.match >= session.first_image]
    alone = _by_itself(session, optimized, own)
    if session.first_image == 0:
        return alone, SessionResult(optimized)
    graph = SessionGraph(store, session, loops)
    T_map_session = graph.align(optimized.poses)
    if T_map_session is None:
        return alone, SessionResult(optimized, MergeResult(verified=len(graph.inter_session)))
    return graph.merge(T_map_session, optimized, config)


def verified_loops(store: MapDatabase) -> list[NumberedLoop]:
    """All loops of a map that have a relative pose."""
    records = enumerate(store.loops())
    return [NumberedLoop(n, record.geometry) for n, record in records if isinstance(record.geometry, LoopClosure)]


class SessionGraph:
    """A new session and the earlier sessions of the map that most of its loops lead to; owns the numbering.

    Images have numbers in the map. The graph counts the images of its sessions without gaps, in the order of `images`.

    Attributes:
        sessions: the earlier sessions, then the new one.
        inter_session: all loops from the new session to earlier ones, of other maps too.
    """

    def __init__(self, store: MapDatabase, session: Session, loops: Sequence[NumberedLoop]) -> None:
        self._store, self._first = store, session.first_image
        self.inter_session = [numbered for numbered in loops if self._is_inter_session(numbered.loop)]
        earlier = _sessions_of_map(store.sessions()[: session.number], self.inter_session)
        self.sessions = (*earlier, session)
        images = [_images(store, one) for one in self.sessions]
        self._before = np.concatenate([np.empty(0, np.int64), *images[:-1]])
        self._own = images[-1]
        self._images = np.concatenate([self._before, self._own])
        members = set(self._images.tolist())
        self._loops = [numbered for numbered in loops if {numbered.loop.match, numbered.loop.query} <= members]

    def align(self, poses: Array) -> Array | None:
        """Start in the map (4, 4) of the new session, poses (N, 4, 4); None if its loops do not agree."""
        loops = [
            renumber(numbered.loop, self._before, self._own)
            for numbered in self._loops
            if self._is_inter_session(numbered.loop)
        ]
        return align_sessions(self._store.poses()[self._before], poses, loops)

    def merge(
        self, T_map_session: Array, alone: OptimizationResult, config: RunConfig
    ) -> tuple[OptimizedSession, SessionResult]:
        """Optimise all sessions in one graph, where the new one begins at T_map_session (4, 4)."""
        poses = self._store.poses()
        poses[self._own] = T_map_session @ alone.poses
        merged = merge_sessions(
            self._trajectories(poses),
            [renumber(numbered.loop, self._images, self._images) for numbered in self._loops],
            config.pose_graph_for_camera(),
            config.robust,
        )
        corrected = OptimizedSession(
            images=self._images,
            poses=merged.poses,
            units=np.ones(len(self._images)),
            outcomes=_outcomes(self._loops, merged.optimized),
            map_id=self.sessions[0].map_id,
        )
        return corrected, SessionResult(self._own_result(alone, merged), self._merge_result(merged))

    def _trajectories(self, poses: Array) -> list[SessionTrajectory]:
        """Steps and poses of each session, of poses (N, 4, 4) of all images of the map."""
        steps = self._store.steps()
        images = [_images(self._store, session) for session in self.sessions]
        return [SessionTrajectory(tuple(steps[one[0] + 1 : one[-1] + 1]), poses[one]) for one in images]

    def _own_result(self, alone: OptimizationResult, merged: MergedSessions) -> OptimizationResult:
        """The new session's part of the merged result, in the frame of that session."""
        own = np.array([numbered.loop.match >= self._first for numbered in self._loops], bool)
        result = merged.optimized
        return replace(
            alone,
            poses=se3.inverse(merged.T_map_session) @ merged.poses[-len(alone.poses) :],
            weights=result.weights[own],
            residuals=result.residuals[own],
            kept=result.kept[own],
            reasons=tuple(reason for reason, is_own in zip(result.reasons, own, strict=True) if is_own),
            seconds=alone.seconds + result.seconds,
        )

    def _merge_result(self, merged: MergedSessions) -> MergeResult:
        across = np.array([self._is_inter_session(numbered.loop) for numbered in self._loops], bool)
        kept = merged.optimized.kept[across]
        return MergeResult(
            joined=True,
            verified=len(kept),
            kept=int(kept.sum()),
            sessions=tuple(session.number for session in self.sessions[:-1]),
            T_map_session=merged.T_map_session,
        )

    def _is_inter_session(self, loop: LoopClosure) -> bool:
        return loop.match < self._first <= loop.query


def renumber(loop: LoopClosure, matches: Images, queries: Images) -> LoopClosure:
    """A loop with its images counted within those of a graph, (M,) and (N,), both increasing."""
    match, query = np.searchsorted(matches, loop.match), np.searchsorted(queries, loop.query)
    return replace(loop, match=int(match), query=int(query))


def _sessions_of_map(earlier: Sequence[Session], loops: Sequence[NumberedLoop]) -> list[Session]:
    """The sessions of the frame of reference that most of the loops lead to."""
    firsts = [session.first_image for session in earlier]
    targets = [int(np.searchsorted(firsts, numbered.loop.match, side="right")) - 1 for numbered in loops]
    map_ids = [earlier[target].map_id for target in targets]
    if not map_ids:
        return []
    main_map = max(sorted(set(map_ids)), key=map_ids.count)
    return [session for session in earlier if session.map_id == main_map]


def _by_itself(session: Session, optimized: OptimizationResult, loops: Sequence[NumberedLoop]) -> OptimizedSession:
    images = session.first_image + np.arange(len(optimized.poses))
    outcomes = _outcomes(loops, optimized) if loops else {}
    return OptimizedSession(images, optimized.poses, optimized.scales, outcomes, session.number)


def _images(store: MapDatabase, session: Session) -> Images:
    return session.first_image + np.arange(store.images(session.number))


def _outcomes(loops: Sequence[NumberedLoop], optimized: OptimizationResult) -> dict[int, LoopOutcome]:
    columns = zip(optimized.kept, optimized.weights, optimized.residuals, optimized.reasons, strict=True)
    return {loop.number: LoopOutcome(*decision) for loop, decision in zip(loops, columns, strict=True)}
