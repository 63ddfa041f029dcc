"""Summary of `revisit places` on screen: recall and counts by both rules, and every stage beside the control."""

from collections.abc import Iterator, Mapping
from typing import Any

from rich.console import Group
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from slam.evaluation.place_metrics import INTERVALS, STAGE_NAMES
from slam.pipeline.place_recognition import PlacesRecord
from slam.report.formatting import describe_static_ratio

_SCORES = ("recall_at_100_precision", "average_precision", "true_positives", "false_positives", "truth_rows")
_STAGES = {"candidates": "candidates", "own": "own score", "geometry": "geometry", "temporal": "temporal model"}
_VALUES = {
    "recall_at_1": "R@1",
    "recall_at_5": "R@5",
    "recall_at_10": "R@10",
    "recall_at_100_precision": "R@P100",
    "average_precision": "AP",
}


def make_summary(record: PlacesRecord) -> Group:
    """Return tables of recall, counts, stages and speed, at most 100 columns wide; unknown values are dashes."""
    places = record.result.section
    table = Table(title=escape(record.name), title_justify="left")
    for heading in ("rule", "R@P100", "AP", "accepted true", "false", "revisits"):
        table.add_column(heading, justify="left" if heading == "rule" else "right")
    table.add_row("authors'", *_format_scores(places))
    tolerant = places["tolerance_10"]
    table.add_row("+-10 images", *_format_scores(tolerant if isinstance(tolerant, dict) else {}))
    run = Text("\n".join(_about_run(record)))
    if record.result.stages is None:
        return Group(table, run)
    lines = [*_about_events(places), *_about_probability(places), *_about_control(record.result.notes)]
    return Group(table, run, "", _stage_table(places), Text("\n".join(lines)))


def _stage_table(places: Mapping[str, Any]) -> Table:
    table = Table(title="Each stage by itself", title_justify="left")
    for heading in ("stage", "", "value", "95 % interval", "random images"):
        table.add_column(heading, justify="left" if heading in ("stage", "") else "right")
    for stage in STAGE_NAMES:
        table.add_section()
        values, control = places["stages"][stage], (places["control"] or {}).get(stage) or {}
        names = [name for name in _VALUES if name in (values or {})]
        if not names:
            table.add_row(_STAGES[stage], "-", "-", "-", "-")
        for row, name in enumerate(names):
            low, high = values[INTERVALS][name]
            cells = (f"{values[name]:.3f}", f"{low:.3f} to {high:.3f}", _number(control.get(name)))
            table.add_row("" if row else _STAGES[stage], _VALUES[name], *cells)
    return table


def _about_run(record: PlacesRecord) -> Iterator[str]:
    places: Mapping[str, Any] = record.result.section
    speed = record.metrics["frames_per_second"]
    size = (places["map_bytes"] or 0) / 1e6
    words = "" if places["words"] is None else f", {places['words']} words"
    yield f"ground truth: {record.metrics['ground_truth']}"
    reference = record.metrics.get("reference")
    if isinstance(reference, dict):
        yield f"reference: {reference['frames']} images, mapped in {reference['mapping_seconds']:.1f} s"
    yield from filter(None, (describe_static_ratio(record.metrics), record.remark))
    yield (
        f"{len(record.beliefs)} images, {len(record.detections)} accepted, {speed:.1f} a second"
        f"; map {size:.1f} MB{words}"
    )
    timing = record.metrics["timing_ms"]
    assert isinstance(timing, dict)
    medians = ", ".join(f"{stage} {spent['median']:.1f}" for stage, spent in timing.items())
    yield f"median ms an image: {medians}"
    if places["delay_frames"] is not None:
        yield f"an answer comes {_range(places['delay_frames'], places['delay_s'], 's')} after its image"


def _about_events(places: Mapping[str, Any]) -> Iterator[str]:
    events: Mapping[str, Any] = places["events"]
    yield f"revisit events: {events['found']} of {events['count']} found"
    for name, words in (("first_match", "first accepted match"), ("first_answer", "known")):
        if events[f"{name}_frames"] is not None:
            yield f"  {words} {_range(events[f'{name}_frames'], events[f'{name}_m'], 'm')} after the first image"


def _about_probability(places: Mapping[str, Any]) -> Iterator[str]:
    found = places["probability"]
    if found is not None:
        yield (
            f"probability: calibration error {found['expected_calibration_error']:.3f}, false at"
            f" {found['sure_probability']} or more: {found['sure_false']} of {found['sure_matches']}"
        )


def _about_control(notes: Mapping[str, str]) -> Iterator[str]:
    """Name the stages that are no better than the control; the notes of metrics.json have the figures."""
    worse = [name for stage, name in _STAGES.items() if "no better" in notes.get(f"places.stages.{stage}", "")]
    if worse:
        yield f"NO BETTER THAN RANDOM IMAGES: {', '.join(worse)}"


def _range(images: Mapping[str, float], lengths: Mapping[str, float] | None, unit: str) -> str:
    """Format median and maximum in images, and in another unit where that is known."""
    middle, largest = (
        f"{images[name]:g} images" + ("" if lengths is None else f" ({lengths[name]:.1f} {unit})")
        for name in ("median", "max")
    )
    return f"{middle} (at most {largest})" if middle != largest else middle


def _format_scores(section: Mapping[str, object]) -> list[str]:
    return [_number(section.get(name), 4) for name in _SCORES]


def _number(value: object, digits: int = 3) -> str:
    return "-" if value is None else f"{value:.{digits}f}" if isinstance(value, float) else str(value)
