"""`revisit evaluate loops`: a table of matches and the truth in; precision, recall and R@P100 out."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from place_recognition.evaluation.ground_truth import SamePlace
from place_recognition.evaluation.precision_recall import PrecisionRecall, precision_recall
from place_recognition.recognizer import Belief
from slam.errors import ConfigError, DataError
from slam.evaluation.truth import KnownTruth, read_truth
from slam.place_metrics import COMMON_TOLERANCE_IMAGES, measure_scores
from slam.storage.matches import read_matches, write_curve
from slam.storage.metrics import metrics_text, write_metrics
from slam.storage.run_folder import RunFolder

_LINES = {
    "recall_at_100_precision": "R@P100",
    "average_precision": "average precision",
    "threshold_at_100_precision": "threshold at R@P100",
    "true_positives": "accepted, true",
    "false_positives": "accepted, false",
}


@dataclass(frozen=True)
class LoopsOptions:
    """What `revisit evaluate loops` is asked.

    Attributes:
        matches: table with the columns query, match and score.
        truth: matrix (.mat, .npz) or poses (KITTI, TUM).
        tolerance: columns that a match may be off, for a third count; None for the two rules in use alone.
        rule: what counts as one place, where the truth is poses.
        fps: poses a second, where the rule has a gap and the poses have no times.
        out: folder for metrics.json and the curve; None to write nothing.
        overwrite: replace earlier results.
    """

    matches: Path
    truth: Path
    tolerance: int | None = None
    rule: SamePlace = field(default_factory=SamePlace)
    fps: float | None = None
    out: Path | None = None
    overwrite: bool = False


def evaluate_loops(options: LoopsOptions, json: bool = False) -> str:
    """Judge matches by the rule of the chapter's authors (no tolerance) and by that of others (10 columns).

    Args:
        options: the files and the rule.
        json: give JSON instead of lines to read.

    Raises:
        DataError: a file is missing or damaged, or the two do not belong together.
        ConfigError: a number that cannot work.
        OutputError: the results cannot be written.
    """
    _check(options)
    beliefs, truth = read_matches(options.matches), _truth(options)
    _check_queries(options.matches, beliefs, truth)
    tolerances = dict.fromkeys((0, COMMON_TOLERANCE_IMAGES, options.tolerance or 0))
    results = {tolerance: measure_scores(beliefs, truth.known, tolerance) for tolerance in tolerances}
    metrics: dict[str, object] = {
        "matches": str(options.matches),
        "ground_truth": truth.origin,
        "queries": len(beliefs),
        "rules": {f"tolerance_{tolerance}": section for tolerance, section in results.items()},
    }
    if options.out is not None:
        _write(options, options.out, metrics, precision_recall(beliefs, truth.known))
    return metrics_text(metrics) if json else "\n".join(_lines(truth, beliefs, results))


def _check(options: LoopsOptions) -> None:
    rule = options.rule
    numbers = {"--radius": rule.radius, "--heading": rule.heading, "--gap": rule.gap, "--way": rule.way}
    for name, value in numbers.items():
        if not 0 <= value < np.inf:
            raise ConfigError(f"{name}: expected a number from 0, found {value}")
    if options.tolerance is not None and options.tolerance < 0:
        raise ConfigError(f"--tolerance: expected columns from 0, found {options.tolerance}")
    if options.fps is not None and not 0 < options.fps < np.inf:
        raise ConfigError(f"--fps: expected poses a second above 0, found {options.fps}")


def _truth(options: LoopsOptions) -> KnownTruth:
    truth = read_truth(options.truth, options.rule, options.fps)
    if not truth.known.any():
        raise DataError(f"{truth.origin}: expected at least one revisit, found none; choose another truth or rule")
    return truth


def _check_queries(matches: Path, beliefs: Sequence[Belief], truth: KnownTruth) -> None:
    last = max((belief.query for belief in beliefs), default=0)
    if last >= len(truth.known):
        raise DataError(
            f"{matches}: expected queries below {len(truth.known)}, the images of {truth.origin}, found {last};"
            " choose the truth of this drive"
        )


def _lines(truth: KnownTruth, beliefs: Sequence[Belief], results: dict[int, dict[str, object]]) -> list[str]:
    revisits = int(truth.known.any(axis=1).sum())
    lines = [f"{len(beliefs)} queries; {revisits} revisits by {truth.origin}"]
    for tolerance, section in results.items():
        lines.append(f"\n{_title(tolerance)}")
        lines += [f"  {title:<24} {_text(section[name])}" for name, title in _LINES.items()]
    return lines


def _title(tolerance: int) -> str:
    rules = {0: "Rule of the chapter's authors: no tolerance", COMMON_TOLERANCE_IMAGES: "Rule of others: +-10 columns"}
    return rules.get(tolerance, f"Your rule: +-{tolerance} columns")


def _text(value: object) -> str:
    return "none" if value is None else f"{value:.4f}" if isinstance(value, float) else str(value)


def _write(options: LoopsOptions, out: Path, metrics: dict[str, object], curve: PrecisionRecall) -> None:
    from slam.report.figures import save_png
    from slam.report.place_figures import plot_precision_recall

    with RunFolder.create(out, options.overwrite) as folder:
        write_metrics(folder.path / "metrics.json", metrics)
        write_curve(folder.path / "precision_recall.csv", curve)
        picture = plot_precision_recall({"all matches": curve}, options.matches.name)
        save_png(picture, folder.path / "precision_recall.png")
        folder.commit()
