"""The end of a drive: its own map corrected, or the map of all drives that it has met."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from slam.config import RunConfig
from slam.loop_closing import LoopClosure
from slam.map_store.store import Corrected, MapStore, Session, Verdict
from slam.robust import OptimizationResult
from slam.sessions import Drive, Joined, Step, join, meeting

Array = NDArray[np.float64]
Images = NDArray[np.int64]
Numbered = tuple[int, LoopClosure]  # number of the attempt, and the loop with images counted through all drives


@dataclass(frozen=True)
class Met:
    """What a drive has to do with the others of the map.

    Attributes:
        joined: it is in one frame with some of them.
        verified: loops to their images that geometry has proved.
        kept: those that stand in the corrected graph.
        sessions: numbers of the drives it is joined with.
        T_map_session: (4, 4) its first camera in their frame; the identity where it is not joined.
    """

    joined: bool = False
    verified: int = 0
    kept: int = 0
    sessions: tuple[int, ...] = ()
    T_map_session: Array = field(default_factory=lambda: np.eye(4))


@dataclass(frozen=True)
class Ended:
    """How a drive has ended.

    Attributes:
        optimized: its trajectory in its own frame, and the verdicts on its own loops.
        met: what it has to do with other drives; None where there are none.
    """

    optimized: OptimizationResult
    met: Met | None = None


@dataclass(frozen=True)
class Conclusion:
    """What the map is told, and what the run is told."""

    corrected: Corrected
    ended: Ended


def stopped(session: Session, optimized: OptimizationResult) -> Conclusion:
    """Correct a drive that was stopped before its end, by itself; it may go on and say more of its loops."""
    images = session.first_image + np.arange(len(optimized.poses))
    corrected = Corrected(images, optimized.poses, optimized.scales, {}, session.number)
    return Conclusion(corrected, Ended(optimized))


def conclude(store: MapStore, session: Session, optimized: OptimizationResult, config: RunConfig) -> Conclusion:
    """Correct the map at the end of a drive.

    Args:
        store: all frames and attempts of the drive are in it.
        session: the drive.
        optimized: the drive by itself.
        config: how it was driven.
    """
    loops = list(_loops(store))
    own = [loop for loop in loops if loop[1].match >= session.first_image]
    images = session.first_image + np.arange(len(optimized.poses))
    alone = Corrected(images, optimized.poses, optimized.scales, _verdicts(own, optimized), session.number)
    if session.first_image == 0:
        return Conclusion(alone, Ended(optimized))
    meetings = [loop for loop in loops if loop[1].match < session.first_image <= loop[1].query]
    known = _known(store.sessions(), session, meetings)
    before = np.concatenate([_images(store, one) for one in known]) if known else np.empty(0, np.int64)
    everything = np.concatenate([before, images])
    together, poses = set(everything.tolist()), store.poses()
    loops = [loop for loop in loops if {loop[1].match, loop[1].query} <= together]
    between = [_counted(loop, before, images) for _, loop in meetings if loop.match in together]
    T_map_session = meeting(poses[before], optimized.poses, between)
    if T_map_session is None:
        return Conclusion(alone, Ended(optimized, Met(verified=len(meetings))))
    poses[images], steps = T_map_session @ optimized.poses, store.steps()
    drives = [_drive(steps, poses, _images(store, one)) for one in (*known, session)]
    joined = join(drives, [_counted(loop, everything, everything) for _, loop in loops], config.graph, config.robust)
    corrected = Corrected(
        everything, joined.poses, np.ones(len(everything)), _verdicts(loops, joined.optimized), known[0].world
    )
    mine = np.array([loop.match >= session.first_image for _, loop in loops], bool)
    across = np.array([loop.match < session.first_image <= loop.query for _, loop in loops], bool)
    met = _met(joined, known, across)
    return Conclusion(corrected, Ended(_of_one(optimized, joined, mine), met))


def _loops(store: MapStore) -> Iterable[Numbered]:
    for number, attempt in enumerate(store.attempts()):
        if isinstance(attempt.geometry, LoopClosure):
            yield number, attempt.geometry


def _known(sessions: Sequence[Session], session: Session, meetings: Sequence[Numbered]) -> list[Session]:
    """The drives of the world into which most of the loops lead."""
    earlier = [one for one in sessions if one.number < session.number]
    firsts = [one.first_image for one in earlier]
    worlds = [earlier[int(np.searchsorted(firsts, loop.match, side="right")) - 1].world for _, loop in meetings]
    if not worlds:
        return []
    most = max(sorted(set(worlds)), key=worlds.count)
    return [one for one in earlier if one.world == most]


def _images(store: MapStore, session: Session) -> Images:
    return session.first_image + np.arange(store.images(session.number))


def _drive(steps: Sequence[Step], poses: Array, images: Images) -> Drive:
    """One of the drives of which these are all steps and poses."""
    return Drive(tuple(steps[images[0] + 1 : images[-1] + 1]), poses[images])


def _counted(loop: LoopClosure, matches: Images, queries: Images) -> LoopClosure:
    """A loop with its images counted within those (M,) and (N,), both rising."""
    match, query = np.searchsorted(matches, loop.match), np.searchsorted(queries, loop.query)
    return replace(loop, match=int(match), query=int(query))


def _verdicts(loops: Sequence[Numbered], optimized: OptimizationResult) -> dict[int, Verdict]:
    columns = (optimized.kept, optimized.weights, optimized.residuals, optimized.reasons)
    return {number: Verdict(*said) for (number, _), *said in zip(loops, *columns, strict=True)}


def _of_one(alone: OptimizationResult, joined: Joined, mine: NDArray[np.bool_]) -> OptimizationResult:
    """What the joined graph says of the last drive, in that one's own frame; mine: (L,) which loops are within it."""
    said = joined.optimized
    return replace(
        alone,
        poses=se3.inverse(joined.T_world_session) @ joined.poses[-len(alone.poses) :],
        weights=said.weights[mine],
        residuals=said.residuals[mine],
        kept=said.kept[mine],
        reasons=tuple(reason for reason, own in zip(said.reasons, mine, strict=True) if own),
        seconds=alone.seconds + said.seconds,
    )


def _met(joined: Joined, known: Sequence[Session], across: NDArray[np.bool_]) -> Met:
    kept = joined.optimized.kept[across]
    return Met(True, len(kept), int(kept.sum()), tuple(one.number for one in known), joined.T_world_session)
