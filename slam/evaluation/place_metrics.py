"""Metrics of place recognition: the section `places` of metrics.json, for `revisit run` and `revisit places`."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from place_recognition.evaluation.memory import MapSize
from place_recognition.evaluation.precision_recall import PrecisionRecall, accepted_counts, precision_recall
from place_recognition.recognizer import Belief

# Images by which a match may miss the true one in the rule of iBoW-LCD and similar systems; the chapter's authors
# allow none.
COMMON_TOLERANCE_IMAGES = 10

_SCORE_NAMES = (
    "recall_at_100_precision",
    "average_precision",
    "threshold_at_100_precision",
    "true_positives",
    "false_positives",
    "truth_rows",
)


@dataclass(frozen=True)
class PlaceMetrics:
    """Metrics of the beliefs of a run.

    Attributes:
        section: the section `places` of metrics.json.
        notes: for each null value in it, by its dotted name, the reason.
        curve: precision-recall curve by the rule of the chapter's authors (no tolerance); None without ground truth.
    """

    section: dict[str, object]
    notes: dict[str, str] = field(default_factory=dict)
    curve: PrecisionRecall | None = None


def evaluate_places(
    paradigm: str, beliefs: Sequence[Belief], truth: NDArray[np.bool_] | None, size: MapSize | None = None
) -> PlaceMetrics:
    """Measure beliefs against the ground truth.

    Args:
        paradigm: name of the recogniser.
        beliefs: one belief per query.
        truth: (N, N) True where two images show one place, row = query, column = earlier image; None if unknown.
        size: size of the recogniser's map; None if unknown.
    """
    words = None if size is None else size.words
    map_size: dict[str, object] = {"words": words, "map_bytes": None if size is None else size.bytes}
    notes = {} if words is not None else {"places.words": f"{paradigm} counts no words"}
    section = {"paradigm": paradigm, "queries": len(beliefs)}
    if truth is None or not truth.any():
        reason = "there is no ground truth" if truth is None else "no image is a revisit by ground truth"
        missing = (*_SCORE_NAMES, "tolerance_10")
        unknown = section | dict.fromkeys(missing) | map_size
        return PlaceMetrics(unknown, notes | {f"places.{name}": reason for name in missing})
    curve = precision_recall(beliefs, truth)
    tolerant = {"tolerance_10": measure_scores(beliefs, truth, COMMON_TOLERANCE_IMAGES)}
    return PlaceMetrics(
        section | measure_scores(beliefs, truth, 0) | tolerant | map_size, notes | _threshold_note(curve), curve
    )


def measure_scores(beliefs: Sequence[Belief], truth: NDArray[np.bool_], tolerance: int) -> dict[str, object]:
    """Return R@P100, average precision and counts for a tolerance in images, named as in metrics.json."""
    curve = precision_recall(beliefs, truth, tolerance)
    values = (
        curve.recall_at_full_precision,
        curve.average_precision,
        curve.threshold_at_full_precision,
        *accepted_counts(beliefs, truth, tolerance),
        curve.truth_rows,
    )
    return dict(zip(_SCORE_NAMES, values, strict=True))


def _threshold_note(curve: PrecisionRecall) -> dict[str, str]:
    if curve.threshold_at_full_precision is not None:
        return {}
    reason = "the detection of the highest score is false" if len(curve.thresholds) else "nothing was detected"
    return {"places.threshold_at_100_precision": reason}
