"""From a drive's beliefs to the files that `revisit places` leaves behind."""

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
from slam.places.drive import Recognised, stage_times
from slam.provenance import peak_memory_mb
from slam.storage.matches import write_curve, write_matches, write_matrix
from slam.storage.metrics import write_metrics


@dataclass(frozen=True)
class PlacesRecord:
    """Everything known after a drive.

    Attributes:
        name: of the drive and of the paradigm, for titles.
        beliefs: by query.
        result: how good they are.
        matrices: by stage, "similarity" first.
        truth: (N, N) of the N images seen, or None.
        metrics: what goes into metrics.json.
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


def make_record(done: Recognised, truth: RevisitTruth, provenance: dict[str, object]) -> PlacesRecord:
    """Gather and measure everything."""
    seen = None if truth.matrix is None else truth.matrix[: done.images, : done.images]
    paradigm = str(provenance["paradigm"])
    beliefs = tuple(sorted(done.beliefs, key=lambda belief: belief.query))
    result = evaluate_places(paradigm, beliefs, seen, done.size)
    stages = ("similarity", *(stage for stage in done.rows.stages if stage != "similarity"))
    return PlacesRecord(
        name=f"{Path(str(provenance['source'])).resolve().name} {provenance['sequence']}: {paradigm}",
        beliefs=beliefs,
        result=result,
        matrices={stage: done.rows.matrix(done.images, stage) for stage in stages},
        truth=seen,
        metrics=provenance | _measured(done, result, truth),
    )


def _measured(done: Recognised, result: PlaceMetrics, truth: RevisitTruth) -> dict[str, object]:
    return {
        "frames": done.images,
        "ground_truth": truth.origin,
        "places": result.section,
        "timing_ms": timing_ms(stage_times(done)),
        "frames_per_second": done.images / done.wall_seconds,
        "wall_seconds": done.wall_seconds,
        "peak_memory_mb": peak_memory_mb(),
        "interrupted": done.interrupted,
        "notes": result.notes,
    }


def write_results(folder: Path, record: PlacesRecord) -> None:
    """Write every file into a folder.

    Raises:
        OutputError: one of them cannot be written.
    """
    from slam.report.figures import save_png
    from slam.report.place_figures import places_picture, precision_recall_picture

    write_metrics(folder / "metrics.json", record.metrics)
    write_matches(folder / "matches.csv", record.beliefs)
    write_curve(folder / "precision_recall.csv", record.result.curve)
    arrays: dict[str, NDArray[np.generic]] = {stage: matrix.values for stage, matrix in record.matrices.items()}
    step = np.array(record.matrices["similarity"].step)
    write_matrix(folder / "matrix.npz", arrays | {"detections": record.detections, "step": step})
    curves = {} if record.result.curve is None else {str(record.metrics["paradigm"]): record.result.curve}
    save_png(precision_recall_picture(curves, record.name), folder / "precision_recall.png")
    picture = places_picture(record.name, record.matrices, record.detections, record.truth)
    save_png(picture, folder / "matrix.png")


def summary(record: PlacesRecord) -> Table:
    """Sum up a drive: recall, counts and speed. What is not known is a dash."""
    places, timing = record.result.section, record.metrics["timing_ms"]
    tolerant = places["tolerance_10"]
    table = Table(title=escape(record.name), caption=_caption(record), caption_justify="left")
    for heading in ("rule", "R@P100", "AP", "accepted true", "false", "revisits"):
        table.add_column(heading, justify="left" if heading == "rule" else "right")
    table.add_row("authors'", *_cells(places))
    table.add_row("+-10 images", *_cells(tolerant if isinstance(tolerant, dict) else {}))
    assert isinstance(timing, dict)
    stages = ", ".join(f"{stage} {spent['median']:.1f}" for stage, spent in timing.items())
    table.caption = f"{table.caption}\nmedian ms an image: {stages}"
    return table


def _cells(section: dict[str, object]) -> list[str]:
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
