"""The ledger: what became of each belief, in one row, with the reason in plain words."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from odometry import se3
from place_recognition.recognizer import Belief
from slam.loop_closing import LoopClosure, Rejection
from slam.loop_trust import LoopEvent
from slam.record import ONLINE_SEPARATOR, LoopRow, MatchedPixels, StageRow
from slam.robust import GateResult, OptimizationResult
from slam.system import LoopAttempt

Judge = Callable[[int, int, LoopClosure | None], bool | None]  # query, match, measured pose -> true revisit?


def write_ledger(attempts: Iterable[LoopAttempt], optimized: OptimizationResult, judge: Judge) -> tuple[LoopRow, ...]:
    """One row for each belief that has a match, by query.

    Args:
        attempts: in the order in which they were made.
        optimized: the verdicts on the closures among them, in the same order.
        judge: tells true revisits from false ones; None where there is no ground truth.
    """
    rows, closures = [], 0
    for attempt in attempts:
        if attempt.belief.match is None:
            continue
        row = _proposed(attempt.belief, attempt.belief.match, judge)
        if isinstance(attempt.geometry, Rejection):
            row = _refused(row, attempt.geometry)
        elif isinstance(attempt.geometry, LoopClosure):
            row = _judged(row, attempt.geometry, optimized, closures, judge)
            closures += 1
        rows.append(row)
    return tuple(sorted(rows, key=lambda row: row.query))


def _proposed(belief: Belief, match: int, judge: Judge) -> LoopRow:
    reason = "accepted by the recogniser"
    if not belief.verified:
        reason = f"not accepted: {belief.inliers or 0} matches agree with one epipolar geometry, too few"
    elif not belief.accepted:
        reason = f"not accepted: score {belief.score:.1f} is below the recogniser's threshold"
    truth = judge(belief.query, match, None)
    return LoopRow(belief.query, match, belief.score, belief.accepted, truth=truth, reason=reason)


def _refused(row: LoopRow, rejection: Rejection) -> LoopRow:
    return replace(row, matches=rejection.matches, inliers=rejection.inliers, reason=rejection.reason)


def _judged(row: LoopRow, closure: LoopClosure, optimized: OptimizationResult, number: int, judge: Judge) -> LoopRow:
    return replace(
        row,
        matches=closure.matches,
        inliers=closure.inliers,
        verified=True,
        in_graph=bool(optimized.kept[number]),
        weight=float(optimized.weights[number]),
        residual=float(optimized.residuals[number]),
        truth=judge(closure.query, closure.match, closure),
        reason=optimized.reasons[number],
    )


def stage_rows(
    attempts: Iterable[LoopAttempt], gates: Sequence[GateResult], history: Iterable[LoopEvent]
) -> tuple[StageRow, ...]:
    """What each stage measured, one row for each belief that has a match, by query.

    Args:
        attempts: in the order in which they were made.
        gates: verdicts on the closures among them, in the same order.
        history: what became of those closures online.
    """
    lives: list[list[str]] = [[] for _ in gates]
    for change in history:
        lives[change.loop].append(f"frame {change.frame}: {change.reason}")
    rows, closures = [], 0
    for attempt in attempts:
        belief = attempt.belief
        if belief.match is None:
            continue
        row = StageRow(belief.query, belief.match, belief.inliers, belief.verified)
        if isinstance(attempt.geometry, LoopClosure):
            gate, online = gates[closures], ONLINE_SEPARATOR.join(lives[closures])
            row = _measured(replace(row, online=online), attempt.geometry, gate)
            closures += 1
        rows.append(row)
    return tuple(sorted(rows, key=lambda row: row.query))


def _measured(row: StageRow, closure: LoopClosure, gate: GateResult) -> StageRow:
    x, y, z = closure.T_match_query[:3, 3].tolist()
    variances = np.diag(closure.covariance)
    return replace(
        row,
        x=x,
        y=y,
        z=z,
        turn_deg=float(np.degrees(se3.angle(closure.T_match_query))),
        sigma_m=float(np.sqrt(variances[3:].mean())),
        sigma_deg=float(np.degrees(np.sqrt(variances[:3].mean()))),
        gate_residual=gate.residual,
        gate_passed=gate.passed,
        gate_reason=gate.reason,
    )


def matched_pixels(attempts: Iterable[LoopAttempt]) -> tuple[MatchedPixels, ...]:
    """Where the images of each belief agree: with a relative pose where one was found, else as the recogniser saw."""
    found = (_agreement(attempt.belief, attempt.geometry) for attempt in attempts)
    return tuple(pair for pair in found if pair is not None)


def _agreement(belief: Belief, geometry: LoopClosure | Rejection | None) -> MatchedPixels | None:
    if belief.match is None:
        return None
    if geometry is not None and len(geometry.pixels_query):
        return MatchedPixels(belief.query, belief.match, geometry.pixels_query, geometry.pixels_match)
    if len(belief.pixels):
        now, then = belief.pixels[:, :2], belief.pixels[:, 2:]
        return MatchedPixels(belief.query, belief.match, now, then, "one epipolar geometry")
    return None
