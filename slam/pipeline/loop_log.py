"""The loop log: one row for each belief of the recogniser, with its outcome and the reason."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from place_recognition.recognizer import Belief
from slam.evaluation.loops import LoopError, is_same_place, is_true_loop, loop_error
from slam.loop_closing.loop_closer import LoopClosure, Rejection
from slam.pose_graph.online_loop_selection import LoopEvent
from slam.pose_graph.robust.backends import GateResult, OptimizationResult
from slam.run_result import LoopEventRow, LoopRow, MatchedPixels, StageRow
from slam.system import LoopCandidate

Array = NDArray[np.float64]

_SURE = 0.999  # probability of a place from which it is worth saying that only local features do not confirm it


class LoopTruth(Protocol):
    """Compares loops with ground truth."""

    def is_true(self, query: int, match: int, closure: LoopClosure | None) -> bool | None:
        """Whether a match is a true revisit, and its relative pose right if it has one; None if that is not known."""
        ...

    def error(self, closure: LoopClosure) -> LoopError:
        """Error of a relative pose; NaN if it is not known."""
        ...


class UnknownLoopTruth:
    """Ground truth that is not known (a LoopTruth)."""

    def is_true(self, query: int, match: int, closure: LoopClosure | None) -> None:
        """Return None."""

    def error(self, closure: LoopClosure) -> LoopError:
        """Return an error of NaN."""
        return LoopError()


@dataclass(frozen=True)
class PoseLoopTruth:
    """Ground truth by true poses (a LoopTruth).

    Attributes:
        poses: true T_world_camera (N, 4, 4), metres.
        unit_m: (N,) unit of length of each frame, metres.
    """

    poses: Array
    unit_m: Array

    def is_true(self, query: int, match: int, closure: LoopClosure | None) -> bool:
        """Whether the relative pose is right; without one, whether both frames show the same place."""
        if closure is None:
            return is_same_place(self.poses, query, match)
        return is_true_loop(self.poses, query, match, self._in_metres(closure))

    def error(self, closure: LoopClosure) -> LoopError:
        """Error of the relative pose, in metres."""
        return loop_error(self.poses, closure.query, closure.match, self._in_metres(closure))

    def _in_metres(self, closure: LoopClosure) -> Array:
        T_match_query = closure.T_match_query.copy()
        T_match_query[:3, 3] *= self.unit_m[closure.match]
        return T_match_query


def loop_rows(
    candidates: Iterable[LoopCandidate], optimized: OptimizationResult, truth: LoopTruth
) -> tuple[LoopRow, ...]:
    """One row for each belief that has a match, by query.

    Args:
        candidates: loop candidates in the order in which they were made.
        optimized: result of the back end, with the closures among them in the same order.
        truth: ground truth of the candidates.
    """
    rows, closures = [], 0
    for candidate in candidates:
        if candidate.belief.match is None:
            continue
        row = _proposed_row(candidate.belief, candidate.belief.match, truth)
        if isinstance(candidate.geometry, Rejection):
            row = _with_rejection(row, candidate.geometry)
        elif isinstance(candidate.geometry, LoopClosure):
            row = _with_closure(row, candidate.geometry, optimized, closures, truth)
            closures += 1
        rows.append(row)
    return tuple(sorted(rows, key=lambda row: row.query))


def _proposed_row(belief: Belief, match: int, truth: LoopTruth) -> LoopRow:
    reason = "accepted by the recogniser"
    if not belief.verified:
        reason = f"not accepted: {belief.inliers or 0} matches agree with one epipolar geometry, too few"
        if belief.probability is not None and belief.probability >= _SURE:
            reason += f"; the place is known without them, probability {belief.probability:.4f}"
    elif not belief.accepted:
        reason = f"not accepted: score {belief.score:.1f} is below the recogniser's threshold"
    is_true = truth.is_true(belief.query, match, None)
    return LoopRow(belief.query, match, belief.score, belief.accepted, truth=is_true, reason=reason)


def _with_rejection(row: LoopRow, rejection: Rejection) -> LoopRow:
    return replace(row, matches=rejection.matches, inliers=rejection.inliers, reason=rejection.reason)


def _with_closure(
    row: LoopRow, closure: LoopClosure, optimized: OptimizationResult, number: int, truth: LoopTruth
) -> LoopRow:
    return replace(
        row,
        matches=closure.matches,
        inliers=closure.inliers,
        verified=True,
        in_graph=bool(optimized.kept[number]),
        weight=float(optimized.weights[number]),
        residual=float(optimized.residuals[number]),
        truth=truth.is_true(closure.query, closure.match, closure),
        reason=optimized.reasons[number],
    )


def stage_rows(
    candidates: Iterable[LoopCandidate], gates: Sequence[GateResult], truth: LoopTruth
) -> tuple[StageRow, ...]:
    """What each stage measured, one row for each belief that has a match, by query.

    Args:
        candidates: loop candidates in the order in which they were made.
        gates: decisions of the drift gate on the closures among them, in the same order.
        truth: ground truth of the candidates.
    """
    rows, closures = [], 0
    for candidate in candidates:
        belief = candidate.belief
        if belief.match is None:
            continue
        row = StageRow(belief.query, belief.match, belief.inliers, belief.verified)
        if isinstance(candidate.geometry, LoopClosure):
            row = _with_measurement(row, candidate.geometry, gates[closures], truth.error(candidate.geometry))
            closures += 1
        rows.append(row)
    return tuple(sorted(rows, key=lambda row: row.query))


def _with_measurement(row: StageRow, closure: LoopClosure, gate: GateResult, error: LoopError) -> StageRow:
    x, y, z = closure.T_match_query[:3, 3].tolist()
    variances = np.diag(closure.covariance)
    return replace(
        row,
        x_m=x,
        y_m=y,
        z_m=z,
        rotation_deg=float(np.degrees(se3.angle(closure.T_match_query))),
        position_sigma_m=float(np.sqrt(variances[3:].mean())),
        rotation_sigma_deg=float(np.degrees(np.sqrt(variances[:3].mean()))),
        gate_sigma=gate.residual,
        gate_passed=gate.passed,
        gate_reason=gate.reason,
        translation_error_m=error.translation_m,
        rotation_error_deg=error.rotation_deg,
    )


def event_rows(candidates: Iterable[LoopCandidate], history: Iterable[LoopEvent]) -> tuple[LoopEventRow, ...]:
    """Decisions of the online pose graph about each closure, by query and in the order in which they were made.

    Args:
        candidates: loop candidates in the order in which they were made.
        history: decisions about the closures among them, whose numbers count these closures.
    """
    closures = [candidate.geometry for candidate in candidates if isinstance(candidate.geometry, LoopClosure)]
    rows = []
    for change in history:
        closure = closures[change.loop]
        rows.append(LoopEventRow(closure.query, closure.match, change.frame, change.used, change.reason))
    return tuple(sorted(rows, key=lambda row: row.query))


def matched_pixels(candidates: Iterable[LoopCandidate]) -> tuple[MatchedPixels, ...]:
    """Pixels where the images of each belief agree: with a relative pose, else with one epipolar geometry."""
    found = (_matched_pixels_of(candidate.belief, candidate.geometry) for candidate in candidates)
    return tuple(pair for pair in found if pair is not None)


def _matched_pixels_of(belief: Belief, geometry: LoopClosure | Rejection | None) -> MatchedPixels | None:
    if belief.match is None:
        return None
    if geometry is not None and len(geometry.pixels_query):
        return MatchedPixels(belief.query, belief.match, geometry.pixels_query, geometry.pixels_match)
    if len(belief.pixels):
        now, then = belief.pixels[:, :2], belief.pixels[:, 2:]
        return MatchedPixels(belief.query, belief.match, now, then, "one epipolar geometry")
    return None
