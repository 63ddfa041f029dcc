"""The stages of place recognition as they stand in metrics.json, with events, delays and probabilities."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from place_recognition.evaluation.precision_recall import PrecisionRecall
from place_recognition.evaluation.reliability import BIN_EDGES, SURE_PROBABILITY, Reliability
from place_recognition.evaluation.revisit_events import answer_delays, find_revisit_events
from place_recognition.evaluation.stages import (
    CURVE_STAGES,
    CURVE_SUMMARIES,
    StageResults,
    measure_stages,
    stage_intervals,
)
from place_recognition.recognizer import Belief

Array = NDArray[np.float64]
Spans = NDArray[np.int64]
Truth = NDArray[np.bool_]
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
