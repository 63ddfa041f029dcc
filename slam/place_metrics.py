"""How well places were recognised in a run: the other half of the picture, beside the trajectory's error."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from place_recognition.evaluation.precision_recall import PrecisionRecall, accepted_counts, precision_recall
from slam.evaluation.loops import LoopRule, revisit_matrix
from slam.system import LoopAttempt

Array = NDArray[np.float64]


def place_metrics(
    attempts: Sequence[LoopAttempt], truth: Array | None, paradigm: str, rule: LoopRule | None = None
) -> tuple[dict[str, object], dict[str, str]]:
    """The section `places` of metrics.json, and notes on what in it is null.

    Args:
        attempts: what became of every belief.
        truth: T_world_camera (N, 4, 4), metres, or None.
        paradigm: name of the recogniser.
        rule: what counts as a revisit.
    """
    measured: dict[str, object] = dict.fromkeys(_MEASURED)
    section = {"paradigm": paradigm, "queries": len(attempts)}
    if truth is None:
        return section | measured, {f"places.{name}": "there is no ground truth" for name in _MEASURED}
    matrix = revisit_matrix(truth, rule)
    if not matrix.any():
        return section | measured, {f"places.{name}": "no image is a revisit by ground truth" for name in _MEASURED}
    beliefs = [attempt.belief for attempt in attempts]
    curve = precision_recall(beliefs, matrix)
    return section | _summary(curve, accepted_counts(beliefs, matrix)), {}


_MEASURED = (
    "recall_at_100_precision",
    "average_precision",
    "threshold_at_100_precision",
    "true_positives",
    "false_positives",
    "truth_rows",
)


def _summary(curve: PrecisionRecall, accepted: tuple[int, int]) -> dict[str, object]:
    values = (
        curve.recall_at_full_precision,
        curve.average_precision,
        curve.threshold_at_full_precision,
        *accepted,
        curve.truth_rows,
    )
    return dict(zip(_MEASURED, values, strict=True))
