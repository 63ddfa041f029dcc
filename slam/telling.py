"""What became of one belief, told stage by stage in plain words."""

import math
from collections.abc import Iterable, Iterator

from slam.record import LoopEventRow, LoopRow, StageRow


def headline(row: LoopRow) -> str:
    """The end of the story in one line."""
    return f"Frame {row.query} with frame {row.match}: {'closed' if row.in_graph else 'not closed'}."


def told(
    paradigm: str, row: LoopRow, stage: StageRow, events: Iterable[LoopEventRow] = ()
) -> Iterator[tuple[str, str]]:
    """Each stage by name, and what it said; a name is empty where the stage before goes on.

    Args:
        paradigm: name of the recogniser.
        row: of the ledger.
        stage: what each stage measured of it.
        events: decisions of the online pose graph about it, in the order in which they were made.
    """
    why = row.reason.removeprefix("not accepted: ")
    accepted = "taken for a revisit" if row.accepted else f"not taken for a revisit: {why}"
    yield "recogniser", f"{paradigm}: score {row.score:.3g}, {accepted}"
    yield "epipolar proof", _epipolar(stage)
    yield "relative pose", _relative_pose(row, stage)
    yield "drift gate", _gate(stage)
    decisions = [f"frame {event.frame}: {event.reason}" for event in events] or ["was not asked"]
    for number, decision in enumerate(decisions):
        yield "" if number else "while driving", decision
    yield "final map", _back_end(row)
    if row.truth is not None:
        wrong = "not a revisit, or its relative pose is wrong" if row.verified else "not a revisit"
        yield "ground truth", "a true revisit" if row.truth else wrong


def _epipolar(stage: StageRow) -> str:
    if stage.epipolar_inliers is None:
        return "none was sought" if stage.epipolar_verified else "failed"
    proved = "enough" if stage.epipolar_verified else "too few"
    return f"{stage.epipolar_inliers} matches agree with one epipolar geometry, {proved}"


def _relative_pose(row: LoopRow, stage: StageRow) -> str:
    if row.verified:
        return (
            f"{row.inliers} of {row.matches} landmark matches agree; the camera had moved {_axes(stage)} m and turned "
            f"{stage.rotation_deg:.2f} deg "
            f"(one sigma {stage.position_sigma_m:.3f} m, {stage.rotation_sigma_deg:.3f} deg)"
        )
    if not row.accepted:
        return "was not sought: the recogniser did not accept the match"
    return f"none: {row.reason} ({row.inliers} of {row.matches} landmark matches agree)"


def _axes(stage: StageRow) -> str:
    named = (("right", "left", stage.x_m), ("down", "up", stage.y_m), ("forward", "back", stage.z_m))
    return ", ".join(f"{abs(value):.2f} {there if value >= 0 else back}" for there, back, value in named)


def _gate(stage: StageRow) -> str:
    if stage.gate_passed is None:
        return "was not asked"
    return f"{'passed' if stage.gate_passed else 'refused'}: {stage.gate_reason}"


def _back_end(row: LoopRow) -> str:
    if math.isnan(row.weight):
        return "was not asked"
    return f"{row.reason} (weight {row.weight:.2f}, residual {row.residual:.2f} sigma)"
