"""Metrics of place recognition: the section `places` of metrics.json, for `revisit run` and `revisit places`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from place_recognition.evaluation.memory import MapSize
from place_recognition.evaluation.precision_recall import PrecisionRecall, Truth, accepted_counts, precision_recall
from place_recognition.evaluation.revisit_ground_truth import answer_delays, find_revisit_events
from place_recognition.evaluation.stages import (
    BIN_EDGES,
    CURVE_STAGES,
    CURVE_SUMMARIES,
    SURE_PROBABILITY,
    Reliability,
    StageResults,
    measure_reliability,
    measure_stages,
    stage_intervals,
)
from place_recognition.recognizer import Belief

Array = NDArray[np.float64]
Spans = NDArray[np.int64]
Section = dict[str, object]
Notes = dict[str, str]

STAGE_NAMES = ("candidates", *CURVE_STAGES)
INTERVALS = "intervals_95"
_NOT_REPORTED = {
    "candidates": "the recogniser reports no candidates",
    "own": "the recogniser reports no score of its own",
    "geometry": "geometry verified no candidate, or the recogniser does not report it",
}
_NO_ANSWER_TIMES = "the recogniser does not report when its answers were ready"
# Values in which a stage must be above the control. The last stage gives the answer: it must be so in both.
_COMPARED = {
    "candidates": ("recall_at_10",),
    "own": ("average_precision",),
    "geometry": ("average_precision",),
    "temporal": ("recall_at_100_precision", "average_precision"),
}


@dataclass(frozen=True)
class DriveData:
    """What is known of a recording besides its images.

    Attributes:
        timestamps: (N,) seconds; None if unknown.
        path_lengths_m: (N,) length of the path from the first image, metres; None if unknown.
    """

    timestamps: Array | None = None
    path_lengths_m: Array | None = None


@dataclass(frozen=True)
class MetricsPart:
    """A part of the metrics.

    Attributes:
        section: its values; some are null.
        notes: for each null value the reason, by the dotted name within the section.
    """

    section: Section
    notes: Notes


def describe_stages(beliefs: Sequence[Belief], truth: Truth, exact: StageResults, tolerance: int) -> MetricsPart:
    """Describe all stages, with confidence intervals, and again with the tolerance of other authors.

    Args:
        beliefs: one belief for each query.
        truth: (N, N) truth matrix, row = query, column = earlier image; at least one row has a true image.
        exact: results of these beliefs without tolerance.
        tolerance: that of other authors, images.
    """
    values, tolerant = _stage_values(exact), _stage_values(measure_stages(beliefs, truth, tolerance))
    intervals = stage_intervals(beliefs, truth)
    section: Section = {
        stage: values[stage] | {INTERVALS: intervals[stage], "tolerance_10": tolerant[stage]}
        if stage in values
        else None
        for stage in STAGE_NAMES
    }
    return MetricsPart(section, {stage: _NOT_REPORTED[stage] for stage in STAGE_NAMES if section[stage] is None})


def compare_with_control(stages: Mapping[str, object], control: Mapping[str, object]) -> Notes:
    """Name the stages that are no better than the control, with the figures.

    A stage is no better where the control's value lies within or above the stage's 95 % interval.

    Args:
        stages: section of the recogniser, as in `describe_stages`.
        control: that of the control.
    """
    notes = {}
    for stage, names in _COMPARED.items():
        ours, theirs = stages[stage], control[stage]
        if isinstance(ours, dict) and isinstance(theirs, dict):
            worse = [_against(name, ours, theirs) for name in names if ours[INTERVALS][name][0] <= theirs[name]]
            if worse:
                notes[stage] = f"no better than random images: {'; '.join(worse)}"
    return notes


def describe_events(beliefs: Sequence[Belief], truth: Truth, tolerance: int, drive: DriveData) -> MetricsPart:
    """Describe the revisit events: how many were found, and how far into an event its first detection is.

    `first_match` is the first query whose match was accepted, `first_answer` the image at which the first accepted
    match was known; both count from the first query of the event, in images and metres.
    """
    events = find_revisit_events(beliefs, truth, tolerance)
    found = [event for event in events if event.detected is not None]
    section: Section = {"count": len(events), "found": len(found), "recall": len(found) / len(events)}
    for name, attribute in (("first_match", "detected"), ("first_answer", "answered_at")):
        ends = [(event.first, getattr(event, attribute)) for event in found]
        spans = np.array([pair for pair in ends if pair[1] is not None], np.int64).reshape(-1, 2)
        section |= _lengths(f"{name}_frames", spans, f"{name}_m", drive.path_lengths_m)
    reason = _NO_ANSWER_TIMES if found else "no event was found"
    return MetricsPart(section, _notes_of_nulls(section, reason, "_m", drive.path_lengths_m, "the poses are not known"))


def describe_delay(beliefs: Sequence[Belief], drive: DriveData) -> MetricsPart:
    """Describe how long after its image each answer came, in images and seconds."""
    section = _lengths("delay_frames", answer_delays(beliefs), "delay_s", drive.timestamps)
    reason = "the recording has no times"
    return MetricsPart(section, _notes_of_nulls(section, _NO_ANSWER_TIMES, "_s", drive.timestamps, reason))


def describe_reliability(exact: Reliability, tolerant: Reliability) -> Section:
    """Describe how far probabilities can be trusted, without and with the tolerance of other authors."""
    columns = (BIN_EDGES, BIN_EDGES[1:], exact.counts, exact.mean_probabilities, exact.true_shares)
    names = ("from", "to", "count", "mean_probability", "true_share")
    rows = [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=False) if row[2]]
    return _trust(exact) | {"bins": rows, "tolerance_10": _trust(tolerant)}


def _stage_values(results: StageResults) -> dict[str, dict[str, object]]:
    candidates: dict[str, object] = {f"recall_at_{k}": value for k, value in results.candidate_recall.items()}
    curves = {stage: _curve_values(curve) for stage, curve in results.curves.items()}
    return ({"candidates": candidates} if candidates else {}) | curves


def _curve_values(curve: PrecisionRecall) -> dict[str, object]:
    values = (curve.recall_at_full_precision, curve.area_under_curve, curve.average_precision)
    return dict(zip(CURVE_SUMMARIES, values, strict=True))


def _against(name: str, ours: dict[str, Any], theirs: dict[str, Any]) -> str:
    low, high = ours[INTERVALS][name]
    return f"{name} {ours[name]:.3f} (95 %: {low:.3f} to {high:.3f}) against {theirs[name]:.3f}"


def _trust(table: Reliability) -> Section:
    return {
        "expected_calibration_error": table.expected_calibration_error,
        "sure_probability": SURE_PROBABILITY,
        "sure_matches": table.sure,
        "sure_false": table.sure_false,
    }


def _lengths(in_images: str, spans: Spans, in_units: str, positions: Array | None) -> Section:
    """Median and maximum length of spans (K, 2) of images, in images and in the unit of the positions (N,)."""
    measured = None if positions is None else np.diff(positions[spans], axis=1)
    return {in_images: _spread(np.diff(spans, axis=1)), in_units: _spread(measured)}


def _spread(values: NDArray[Any] | None) -> Section | None:
    if values is None or not values.size:
        return None
    return {"median": float(np.median(values)), "max": float(np.max(values))}


def _notes_of_nulls(section: Section, reason: str, suffix: str, positions: Array | None, unknown: str) -> Notes:
    """Give the reason of each null: that of the suffix where its positions are unknown, else the general one."""
    nulls = [name for name, value in section.items() if value is None]
    return {name: unknown if positions is None and name.endswith(suffix) else reason for name in nulls}


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
    truth: Truth | None,
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


def measure_scores(beliefs: Sequence[Belief], truth: Truth, tolerance: int) -> dict[str, object]:
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
    truth: Truth,
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


def _probability(beliefs: Sequence[Belief], truth: Truth, reliability: Reliability | None) -> MetricsPart:
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
