"""Explanation of a row of the loop log: what each stage decided about a match, in words."""

import math
from collections.abc import Iterable, Iterator

from slam.run_result import LoopEventRow, LoopRow, StageRow

_NOT_REACHED = "not reached"  # the match was rejected by an earlier stage


def describe_outcome(row: LoopRow) -> str:
    """Return in one line whether the loop was closed."""
    return f"Frame {row.query} with frame {row.match}: {'closed' if row.in_graph else 'not closed'}."


def describe_stages(
    paradigm: str, row: LoopRow, stage: StageRow, events: Iterable[LoopEventRow] = ()
) -> Iterator[tuple[str, str]]:
    """Yield the name of each stage and its decision in words; the name is empty for further lines of a stage.

    Args:
        paradigm: name of the recogniser.
        row: row of the loop log.
        stage: measurements of each stage for this row.
        events: decisions of the online pose graph about it, in the order in which they were made.
    """
    reason = row.reason.removeprefix("not accepted: ")
    accepted = "accepted as a revisit" if row.accepted else f"not accepted as a revisit: {reason}"
    yield "recogniser", f"{paradigm}: score {row.score:.3g}, {accepted}"
    yield "epipolar check", _epipolar(stage)
    yield "relative pose", _relative_pose(row, stage)
    yield "drift gate", _gate(stage)
    decisions = [f"frame {event.frame}: {event.reason}" for event in events] or [_NOT_REACHED]
    for number, decision in enumerate(decisions):
        yield "" if number else "while driving", decision
    yield "final map", _back_end(row)
    if row.truth is not None:
        wrong = "not a revisit, or a wrong relative pose" if row.verified else "not a revisit"
        yield "ground truth", "a true revisit" if row.truth else wrong


def _epipolar(stage: StageRow) -> str:
    if stage.epipolar_inliers is None:
        return "not checked" if stage.epipolar_verified else "failed"
    amount = "enough" if stage.epipolar_verified else "too few"
    return f"{stage.epipolar_inliers} matches agree with one epipolar geometry, {amount}"


def _relative_pose(row: LoopRow, stage: StageRow) -> str:
    if row.verified:
        return (
            f"{row.inliers} of {row.matches} landmark matches agree; the camera moved {_axes(stage)} m and turned "
            f"{stage.rotation_deg:.2f} deg "
            f"(one sigma {stage.position_sigma_m:.3f} m, {stage.rotation_sigma_deg:.3f} deg)"
        )
    if not row.accepted:
        return f"{_NOT_REACHED}: the recogniser did not accept the match"
    return f"not found: {row.reason} ({row.inliers} of {row.matches} landmark matches agree)"


def _axes(stage: StageRow) -> str:
    axes = (("right", "left", stage.x_m), ("down", "up", stage.y_m), ("forward", "back", stage.z_m))
    return ", ".join(f"{abs(value):.2f} {plus if value >= 0 else minus}" for plus, minus, value in axes)


def _gate(stage: StageRow) -> str:
    if stage.gate_passed is None:
        return _NOT_REACHED
    return f"{'passed' if stage.gate_passed else 'rejected'}: {stage.gate_reason}"


def _back_end(row: LoopRow) -> str:
    if math.isnan(row.weight):
        return _NOT_REACHED
    return f"{row.reason} (weight {row.weight:.2f}, residual {row.residual:.2f} sigma)"
