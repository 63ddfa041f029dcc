"""Metrics of place recognition: the section `places` of metrics.json, for `revisit run` and `revisit places`."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from place_recognition.evaluation.memory import MapSize
from place_recognition.evaluation.precision_recall import PrecisionRecall, accepted_counts, precision_recall
from place_recognition.evaluation.reliability import Reliability, measure_reliability
from place_recognition.evaluation.stages import StageResults, measure_stages
from place_recognition.recognizer import Belief
from slam.evaluation.place_stages import (
    STAGE_NAMES,
    DriveData,
    MetricsPart,
    compare_with_control,
    describe_delay,
    describe_events,
    describe_reliability,
    describe_stages,
)

# Images by which a match may miss the true one in the rule of iBoW-LCD and similar systems; the chapter's authors
# allow none.
COMMON_TOLERANCE_IMAGES = 10

CONTROL = "random-images: random past images go through the same geometry and temporal model as the candidates"
NO_CONTROL = "`revisit places` measures the control"

_SCORE_NAMES = (
    "recall_at_100_precision",
    "average_precision",
    "threshold_at_100_precision",
    "true_positives",
    "false_positives",
    "truth_rows",
)
_NEEDS_TRUTH = (*_SCORE_NAMES, "tolerance_10", "events", "probability", "control")


@dataclass(frozen=True)
class PlaceMetrics:
    """Metrics of the beliefs of a run.

    Attributes:
        section: the section `places` of metrics.json.
        notes: for each null value in it, by its dotted name, the reason; and which stages are no better than the
            control.
        curve: precision-recall curve by the rule of the chapter's authors (no tolerance); None without ground truth.
        stages: results of each stage by the same rule; None without ground truth.
        control: those of the control; None where there was none.
        reliability: how far the probabilities can be trusted; None without ground truth or probabilities.
    """

    section: dict[str, object]
    notes: dict[str, str] = field(default_factory=dict)
    curve: PrecisionRecall | None = None
    stages: StageResults | None = None
    control: StageResults | None = None
    reliability: Reliability | None = None


def evaluate_places(
    paradigm: str,
    beliefs: Sequence[Belief],
    truth: NDArray[np.bool_] | None,
    size: MapSize | None = None,
    drive: DriveData | None = None,
    control: Sequence[Belief] | None = None,
) -> PlaceMetrics:
    """Measure beliefs against the ground truth.

    Args:
        paradigm: name of the recogniser.
        beliefs: one belief per query.
        truth: (N, N) True where two images show one place, row = query, column = earlier image; None if unknown.
        size: size of the recogniser's map; None if unknown.
        drive: times and path lengths of the images, as far as they are known.
        control: beliefs of the control about the same images; None where it was not run.
    """
    words = None if size is None else size.words
    notes = {} if words is not None else {"words": f"{paradigm} counts no words"}
    map_size = MetricsPart({"words": words, "map_bytes": None if size is None else size.bytes}, notes)
    heading = MetricsPart({"paradigm": paradigm, "queries": len(beliefs)}, {})
    drive = drive or DriveData()
    always = [map_size, describe_delay(beliefs, drive)]
    if truth is None or not truth.any():
        reason = "there is no ground truth" if truth is None else "no image is a revisit by ground truth"
        return PlaceMetrics(*_join([heading, *_unknown(reason), *always]))
    curve, results = precision_recall(beliefs, truth), measure_stages(beliefs, truth)
    control_results = None if control is None else measure_stages(control, truth)
    reliability = measure_reliability(beliefs, truth)
    parts = [
        MetricsPart(measure_scores(beliefs, truth, 0), _threshold_note(curve)),
        MetricsPart({"tolerance_10": measure_scores(beliefs, truth, COMMON_TOLERANCE_IMAGES)}, {}),
        *_stages_and_control(beliefs, results, control, control_results, truth),
        _nest("events", describe_events(beliefs, truth, 0, drive)),
        _probability(beliefs, truth, reliability),
    ]
    return PlaceMetrics(*_join([heading, *parts, *always]), curve, results, control_results, reliability)


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


def _unknown(reason: str) -> list[MetricsPart]:
    """Return the values that need ground truth, all null."""
    stages = MetricsPart(dict.fromkeys(STAGE_NAMES), dict.fromkeys(STAGE_NAMES, reason))
    return [MetricsPart(dict.fromkeys(_NEEDS_TRUTH), dict.fromkeys(_NEEDS_TRUTH, reason)), _nest("stages", stages)]


def _stages_and_control(
    beliefs: Sequence[Belief],
    results: StageResults,
    control: Sequence[Belief] | None,
    control_results: StageResults | None,
    truth: NDArray[np.bool_],
) -> list[MetricsPart]:
    ours = describe_stages(beliefs, truth, results, COMMON_TOLERANCE_IMAGES)
    if control is None or control_results is None:
        return [_nest("stages", ours), MetricsPart({"control": None}, {"control": NO_CONTROL})]
    theirs = describe_stages(control, truth, control_results, COMMON_TOLERANCE_IMAGES)
    worse = compare_with_control(ours.section, theirs.section)
    return [
        _nest("stages", MetricsPart(ours.section, ours.notes | worse)),
        _nest("control", MetricsPart({"what": CONTROL} | theirs.section, theirs.notes)),
    ]


def _probability(beliefs: Sequence[Belief], truth: NDArray[np.bool_], reliability: Reliability | None) -> MetricsPart:
    tolerant = measure_reliability(beliefs, truth, COMMON_TOLERANCE_IMAGES)
    if reliability is None or tolerant is None:
        return MetricsPart({"probability": None}, {"probability": "the recogniser computes no probabilities"})
    return MetricsPart({"probability": describe_reliability(reliability, tolerant)}, {})


def _nest(name: str, part: MetricsPart) -> MetricsPart:
    return MetricsPart({name: part.section}, {f"{name}.{key}": reason for key, reason in part.notes.items()})


def _join(parts: Sequence[MetricsPart]) -> tuple[dict[str, object], dict[str, str]]:
    section: dict[str, object] = {}
    notes: dict[str, str] = {}
    for part in parts:
        section |= part.section
        notes |= {f"places.{key}": reason for key, reason in part.notes.items()}
    return section, notes


def _threshold_note(curve: PrecisionRecall) -> dict[str, str]:
    if curve.threshold_at_full_precision is not None:
        return {}
    reason = "the detection of the highest score is false" if len(curve.thresholds) else "nothing was detected"
    return {"threshold_at_100_precision": reason}
