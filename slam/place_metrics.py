"""Quality of place recognition: the section `places` of metrics.json, of `revisit run` and of `revisit places`."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from place_recognition.evaluation.map_size import MapSize
from place_recognition.evaluation.precision_recall import PrecisionRecall, accepted_counts, precision_recall
from place_recognition.recognizer import Belief

TOLERANCE_FRAMES = 10  # by which iBoW-LCD and others accept a match; docs/decisions/evaluation_rules.md

_QUALITY_KEYS = (
    "recall_at_100_precision",
    "average_precision",
    "threshold_at_100_precision",
    "true_positives",
    "false_positives",
    "truth_rows",
)


@dataclass(frozen=True)
class PlaceMetrics:
    """Quality of the beliefs of a drive.

    Attributes:
        metrics: section `places` of metrics.json.
        notes: reason why a value is null, by its dotted key.
        curve: precision and recall without tolerance; None without ground truth.
    """

    metrics: dict[str, object]
    notes: dict[str, str] = field(default_factory=dict)
    curve: PrecisionRecall | None = None


def evaluate_places(
    paradigm: str, beliefs: Sequence[Belief], truth: NDArray[np.bool_] | None, size: MapSize | None = None
) -> PlaceMetrics:
    """Compare the beliefs of a drive with ground truth.

    Args:
        paradigm: name of the place-recognition paradigm.
        beliefs: one belief for each query.
        truth: (N, N) bool, row = query, column = earlier image; None if there is no ground truth.
        size: size of the map of the recogniser; None if it is not measured.
    """
    words = None if size is None else size.words
    map_size: dict[str, object] = {"words": words, "map_bytes": None if size is None else size.bytes}
    notes = {} if words is not None else {"places.words": f"{paradigm} has no words"}
    section: dict[str, object] = {"paradigm": paradigm, "queries": len(beliefs)}
    if truth is None or not truth.any():
        reason = "there is no ground truth" if truth is None else "no image is a revisit by ground truth"
        missing = (*_QUALITY_KEYS, "tolerance_10")
        unknown = section | dict.fromkeys(missing) | map_size
        return PlaceMetrics(unknown, notes | {f"places.{name}": reason for name in missing})
    curve = precision_recall(beliefs, truth)
    tolerant = {"tolerance_10": match_metrics(beliefs, truth, TOLERANCE_FRAMES)}
    return PlaceMetrics(
        section | match_metrics(beliefs, truth, 0) | tolerant | map_size, notes | _threshold_note(curve), curve
    )


def match_metrics(beliefs: Sequence[Belief], truth: NDArray[np.bool_], tolerance: int) -> dict[str, object]:
    """Compute R@P100, average precision and counts under a tolerance in images, with the keys of metrics.json."""
    curve = precision_recall(beliefs, truth, tolerance)
    values = (
        curve.recall_at_full_precision,
        curve.average_precision,
        curve.threshold_at_full_precision,
        *accepted_counts(beliefs, truth, tolerance),
        curve.truth_rows,
    )
    return dict(zip(_QUALITY_KEYS, values, strict=True))


def _threshold_note(curve: PrecisionRecall) -> dict[str, str]:
    if curve.threshold_at_full_precision is not None:
        return {}
    reason = "the detection with the highest score is false" if len(curve.thresholds) else "nothing was detected"
    return {"places.threshold_at_100_precision": reason}
