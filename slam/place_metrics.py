"""How well places were recognised: the section `places` of metrics.json, of a run and of `revisit places`."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from place_recognition.evaluation.map_size import MapSize
from place_recognition.evaluation.precision_recall import PrecisionRecall, accepted_counts, precision_recall
from place_recognition.recognizer import Belief

TOLERANCE_FRAMES = 10  # columns; the rule of iBoW-LCD and its kin, while the chapter's authors allow none

_MEASURED = (
    "recall_at_100_precision",
    "average_precision",
    "threshold_at_100_precision",
    "true_positives",
    "false_positives",
    "truth_rows",
)


@dataclass(frozen=True)
class PlaceMetrics:
    """How good the beliefs of a drive are.

    Attributes:
        section: for metrics.json.
        notes: why a value in it is null, by its dotted name.
        curve: by the rule of the chapter's authors (no tolerance); None without ground truth.
    """

    section: dict[str, object]
    notes: dict[str, str] = field(default_factory=dict)
    curve: PrecisionRecall | None = None


def evaluate_places(
    paradigm: str, beliefs: Sequence[Belief], truth: NDArray[np.bool_] | None, size: MapSize | None = None
) -> PlaceMetrics:
    """Measure beliefs.

    Args:
        paradigm: name of the recogniser.
        beliefs: one a query.
        truth: (N, N), row = query, column = earlier image, or None.
        size: of the recogniser's map, where it is known.
    """
    words = None if size is None else size.words
    held: dict[str, object] = {"words": words, "map_bytes": None if size is None else size.bytes}
    notes = {} if words is not None else {"places.words": f"{paradigm} counts no words"}
    section = {"paradigm": paradigm, "queries": len(beliefs)}
    if truth is None or not truth.any():
        reason = "there is no ground truth" if truth is None else "no image is a revisit by ground truth"
        missing = (*_MEASURED, "tolerance_10")
        unknown = section | dict.fromkeys(missing) | held
        return PlaceMetrics(unknown, notes | {f"places.{name}": reason for name in missing})
    curve = precision_recall(beliefs, truth)
    tolerant = {"tolerance_10": score(beliefs, truth, TOLERANCE_FRAMES)}
    return PlaceMetrics(section | score(beliefs, truth, 0) | tolerant | held, notes | _threshold_note(curve), curve)


def score(beliefs: Sequence[Belief], truth: NDArray[np.bool_], tolerance: int) -> dict[str, object]:
    """R@P100, average precision and counts under a tolerance (see `precision_recall.judge`), as in metrics.json."""
    curve = precision_recall(beliefs, truth, tolerance)
    values = (
        curve.recall_at_full_precision,
        curve.average_precision,
        curve.threshold_at_full_precision,
        *accepted_counts(beliefs, truth, tolerance),
        curve.truth_rows,
    )
    return dict(zip(_MEASURED, values, strict=True))


def _threshold_note(curve: PrecisionRecall) -> dict[str, str]:
    if curve.threshold_at_full_precision is not None:
        return {}
    reason = "even the surest detection is false" if len(curve.thresholds) else "nothing was detected"
    return {"places.threshold_at_100_precision": reason}
