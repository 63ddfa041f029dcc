"""The loop log: one row for each belief of the recogniser, with its outcome and the reason."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from odometry import se3
from place_recognition.recognizer import Belief
from slam.loop_closing.loop_closer import LoopClosure, Rejection
from slam.pose_graph.online_loop_selection import LoopEvent
from slam.pose_graph.robust.backends import GateResult, OptimizationResult
from slam.run_result import LoopEventRow, LoopRow, MatchedPixels, StageRow
from slam.system import LoopCandidate

LoopTruth = Callable[[int, int, LoopClosure | None], bool | None]  # query, match, relative pose -> true revisit?


def loop_rows(
    candidates: Iterable[LoopCandidate], optimized: OptimizationResult, truth: LoopTruth
) -> tuple[LoopRow, ...]:
    """One row for each belief that has a match, by query.

    Args:
        candidates: loop candidates in the order in which they were made.
        optimized: result of the back end, with the closures among them in the same order.
        truth: function that tells whether a candidate is a true revisit; it returns None without ground truth.
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
    elif not belief.accepted:
        reason = f"not accepted: score {belief.score:.1f} is below the recogniser's threshold"
    is_true = truth(belief.query, match, None)
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
        truth=truth(closure.query, closure.match, closure),
        reason=optimized.reasons[number],
    )


def stage_rows(candidates: Iterable[LoopCandidate], gates: Sequence[GateResult]) -> tuple[StageRow, ...]:
    """What each stage measured, one row for each belief that has a match, by query.

    Args:
        candidates: loop candidates in the order in which they were made.
        gates: decisions of the drift gate on the closures among them, in the same order.
    """
    rows, closures = [], 0
    for candidate in candidates:
        belief = candidate.belief
        if belief.match is None:
            continue
        row = StageRow(belief.query, belief.match, belief.inliers, belief.verified)
        if isinstance(candidate.geometry, LoopClosure):
            row = _with_measurement(row, candidate.geometry, gates[closures])
            closures += 1
        rows.append(row)
    return tuple(sorted(rows, key=lambda row: row.query))


def _with_measurement(row: StageRow, closure: LoopClosure, gate: GateResult) -> StageRow:
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
