"""Results of `revisit places`: metrics, and every file that it writes."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.markup import escape
from rich.table import Table

from place_recognition.evaluation.matrix import SimilarityMatrix
from place_recognition.recognizer import Belief
from slam.clock import timing_ms
from slam.evaluation.truth import RevisitTruth
from slam.place_metrics import PlaceMetrics, evaluate_places
from slam.places.drive import PlaceRecognitionRun, stage_times
from slam.provenance import peak_memory_mb
from slam.storage.matches import write_curve, write_matches, write_matrix
from slam.storage.metrics import write_metrics


@dataclass(frozen=True)
class PlacesRecord:
    """Everything known after a run.

    Attributes:
        name: name of the recording and of the paradigm, for titles.
        beliefs: beliefs sorted by query.
        result: metrics of the beliefs.
        matrices: similarity matrix of each stage, "similarity" first.
        truth: (N, N) ground truth of the N images seen, or None.
        metrics: content of metrics.json.
    """

    name: str
    beliefs: tuple[Belief, ...]
    result: PlaceMetrics
    matrices: dict[str, SimilarityMatrix]
    truth: NDArray[np.bool_] | None
    metrics: dict[str, object]

    @property
    def detections(self) -> NDArray[np.int64]:
        """(K, 2) query and match of the accepted beliefs."""
        pairs = [(belief.query, belief.match) for belief in self.beliefs if belief.accepted]
        return np.array(pairs, np.int64).reshape(-1, 2)


def make_record(run: PlaceRecognitionRun, truth: RevisitTruth, provenance: dict[str, object]) -> PlacesRecord:
    """Gather the results of a run and measure them.

    Args:
        run: beliefs, times and matrices.
        truth: ground truth of the whole recording.
        provenance: source, settings and versions, for metrics.json.
    """
    seen = None if truth.matrix is None else truth.matrix[: run.images, : run.images]
    paradigm = str(provenance["paradigm"])
    beliefs = tuple(sorted(run.beliefs, key=lambda belief: belief.query))
    result = evaluate_places(paradigm, beliefs, seen, run.size)
    stages = ("similarity", *(stage for stage in run.rows.stages if stage != "similarity"))
    return PlacesRecord(
        name=f"{Path(str(provenance['source'])).resolve().name} {provenance['sequence']}: {paradigm}",
        beliefs=beliefs,
        result=result,
        matrices={stage: run.rows.matrix(run.images, stage) for stage in stages},
        truth=seen,
        metrics=provenance | _measure(run, result, truth),
    )


def _measure(run: PlaceRecognitionRun, result: PlaceMetrics, truth: RevisitTruth) -> dict[str, object]:
    return {
        "frames": run.images,
        "ground_truth": truth.origin,
        "places": result.section,
        "timing_ms": timing_ms(stage_times(run)),
        "frames_per_second": run.images / run.wall_seconds,
        "wall_seconds": run.wall_seconds,
        "peak_memory_mb": peak_memory_mb(),
        "interrupted": run.interrupted,
        "notes": result.notes,
    }


def write_results(folder: Path, record: PlacesRecord) -> None:
    """Write every result file into a folder.

    Raises:
        OutputError: a file cannot be written.
    """
    from slam.report.figures import save_png
    from slam.report.place_figures import plot_places, plot_precision_recall

    write_metrics(folder / "metrics.json", record.metrics)
    write_matches(folder / "matches.csv", record.beliefs)
    write_curve(folder / "precision_recall.csv", record.result.curve)
    arrays: dict[str, NDArray[np.generic]] = {stage: matrix.values for stage, matrix in record.matrices.items()}
    step = np.array(record.matrices["similarity"].step)
    write_matrix(folder / "matrix.npz", arrays | {"detections": record.detections, "step": step})
    curves = {} if record.result.curve is None else {str(record.metrics["paradigm"]): record.result.curve}
    save_png(plot_precision_recall(curves, record.name), folder / "precision_recall.png")
    picture = plot_places(record.name, record.matrices, record.detections, record.truth)
    save_png(picture, folder / "matrix.png")


def make_summary(record: PlacesRecord) -> Table:
    """Return a table of recall, counts and speed; unknown values are dashes."""
    places, timing = record.result.section, record.metrics["timing_ms"]
    tolerant = places["tolerance_10"]
    table = Table(title=escape(record.name), caption=_caption(record), caption_justify="left")
    for heading in ("rule", "R@P100", "AP", "accepted true", "false", "revisits"):
        table.add_column(heading, justify="left" if heading == "rule" else "right")
    table.add_row("authors'", *_format_cells(places))
    table.add_row("+-10 images", *_format_cells(tolerant if isinstance(tolerant, dict) else {}))
    assert isinstance(timing, dict)
    stages = ", ".join(f"{stage} {spent['median']:.1f}" for stage, spent in timing.items())
    table.caption = f"{table.caption}\nmedian ms an image: {stages}"
    return table


def _format_cells(section: dict[str, object]) -> list[str]:
    names = ("recall_at_100_precision", "average_precision", "true_positives", "false_positives", "truth_rows")
    values = [section.get(name) for name in names]
    return ["-" if v is None else f"{v:.4f}" if isinstance(v, float) else str(v) for v in values]


def _caption(record: PlacesRecord) -> str:
    places, speed = record.result.section, record.metrics["frames_per_second"]
    size = float(str(places["map_bytes"] or 0)) / 1e6
    words = "" if places["words"] is None else f", {places['words']} words"
    lines = [
        f"ground truth: {record.metrics['ground_truth']}",
        f"{len(record.beliefs)} images, {len(record.detections)} accepted, {speed:.1f} a second"
        f"; map {size:.1f} MB{words}",
    ]
    return escape("\n".join(lines))
