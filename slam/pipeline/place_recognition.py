"""Pipeline of `revisit places`: a recogniser without odometry, from images to beliefs, metrics and result files."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.markup import escape
from rich.table import Table

from place_recognition.evaluation.memory import MapSize, map_size
from place_recognition.evaluation.similarity_matrix import MatrixRecorder, SimilarityMatrix
from place_recognition.image_processing.local_features import FeatureCache, FeatureExtractor, LocalFeatures
from place_recognition.paradigms.registry import ParadigmsConfig, make_feature_extractor, with_preset
from place_recognition.recognizer import Belief, MatrixSink, PlaceRecognizer
from slam.components import build_recognizer
from slam.datasets.prefetch import Recording, prefetch
from slam.evaluation.place_metrics import PlaceMetrics, evaluate_places
from slam.evaluation.revisit_truth_files import RevisitTruth
from slam.io.matches import write_curve, write_matches, write_matrix
from slam.io.metrics import write_metrics
from slam.pipeline.provenance import peak_memory_mb
from slam.timing import StageTimer, timed, timing_ms

Image = NDArray[np.uint8]


Array = NDArray[np.float64]

_WARM_UP_IMAGES = 3  # enough that every numba kernel is compiled before the timing starts


@dataclass
class PlaceRecognitionRun:
    """Result of a run of a recogniser over a recording.

    Attributes:
        beliefs: one belief for each processed image, in the order in which they became ready.
        stage_ms: milliseconds of each stage, one entry per image.
        rows: rows of the similarity matrices.
        size: size of the map at the end.
        interrupted: whether the user stopped the run.
        wall_seconds: time from the first image to the last belief.
    """

    beliefs: list[Belief] = field(default_factory=list)
    stage_ms: list[dict[str, float]] = field(default_factory=list)
    rows: MatrixRecorder = field(default_factory=MatrixRecorder)
    size: MapSize | None = None
    interrupted: bool = False
    wall_seconds: float = 0.0

    @property
    def images(self) -> int:
        """Number of processed images."""
        return len(self.stage_ms)


class TimedExtractor:
    """Measures the time of another extractor as the stage `features` (a FeatureExtractor)."""

    def __init__(self, inner: FeatureExtractor, clock: StageTimer) -> None:
        self._inner, self._clock = inner, clock

    @property
    def kind(self) -> str:
        """Name of the descriptor."""
        return self._inner.kind

    def extract(self, image: Image) -> LocalFeatures:
        """Return the features of a grey image (H, W) uint8."""
        with self._clock.stage("features"):
            return self._inner.extract(image)


class RecognizerFactory:
    """Makes recognisers of one paradigm; their feature extraction is timed separately."""

    def __init__(self, paradigm: str, config: ParadigmsConfig) -> None:
        self.clock = StageTimer()
        self._paradigm, self._config = paradigm, with_preset(paradigm, config)

    def make(self, rows: MatrixSink | None = None) -> PlaceRecognizer:
        """Make a new recogniser.

        Raises:
            DataError: its vocabulary or descriptor file cannot be used.
        """
        features = FeatureCache(TimedExtractor(make_feature_extractor(self._config), self.clock))
        return build_recognizer(self._paradigm, features, self._config, rows)


def run_recognizer(
    images: Recording[Image],
    factory: RecognizerFactory,
    show_progress: Callable[[int, int], None],
    should_stop: Callable[[], bool],
) -> PlaceRecognitionRun:
    """Run a recogniser once over all images, in order, without a measured distance.

    Args:
        images: images of the recording; a thread reads ahead.
        factory: makes the recogniser.
        show_progress: called after each image with the number of images done and their total number.
        should_stop: called after each image; returns whether to end the run there.

    Raises:
        DataError: an image cannot be read, or the recogniser cannot be made (`RecognizerFactory.make`).
    """
    _warm_up(images, factory)
    run = PlaceRecognitionRun()
    recognizer, start = factory.make(run.rows), time.perf_counter()
    for index, image in enumerate(timed(prefetch(images), factory.clock)):
        with factory.clock.stage("place recognition"):
            run.beliefs += recognizer.observe(index, image, float("nan"))
        run.stage_ms.append(_subtract_features(factory.clock.lap()))
        show_progress(index + 1, len(images))
        if should_stop():
            run.interrupted = True
            break
    run.beliefs += recognizer.finish()
    return replace(run, size=map_size(recognizer), wall_seconds=time.perf_counter() - start)


def stage_times(run: PlaceRecognitionRun) -> dict[str, Array]:
    """Return the milliseconds (N,) of each stage for the N images."""
    stages = dict.fromkeys(stage for spent in run.stage_ms for stage in spent)
    return {stage: np.array([spent.get(stage, 0.0) for spent in run.stage_ms]) for stage in stages}


def _warm_up(images: Recording[Image], factory: RecognizerFactory) -> None:
    """Compile all kernels on a second recogniser, so that the timer measures recognition alone."""
    recognizer = factory.make()
    for index in range(min(_WARM_UP_IMAGES, len(images))):
        recognizer.observe(index, images[index], float("nan"))
    factory.clock.lap()


def _subtract_features(spent: dict[str, float]) -> dict[str, float]:
    """Subtract the time of the features, which the recogniser extracts inside `observe`, from its own time."""
    return spent | {"place recognition": spent["place recognition"] - spent.get("features", 0.0)}


@dataclass(frozen=True)
class PlacesRecord:
    """Everything that the result files are written from.

    Attributes:
        name: name of the recording and of the paradigm, for titles.
        beliefs: beliefs sorted by query.
        result: metrics of the beliefs.
        matrices: similarity matrix of each stage, "similarity" first.
        truth: (N, N) ground truth of the N processed images, or None.
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
    seen_truth = None if truth.matrix is None else truth.matrix[: run.images, : run.images]
    paradigm = str(provenance["paradigm"])
    beliefs = tuple(sorted(run.beliefs, key=lambda belief: belief.query))
    result = evaluate_places(paradigm, beliefs, seen_truth, run.size)
    stages = ("similarity", *(stage for stage in run.rows.stages if stage != "similarity"))
    return PlacesRecord(
        name=f"{Path(str(provenance['source'])).resolve().name} {provenance['sequence']}: {paradigm}",
        beliefs=beliefs,
        result=result,
        matrices={stage: run.rows.matrix(run.images, stage) for stage in stages},
        truth=seen_truth,
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
    from slam.report.place_recognition_figures import plot_places, plot_precision_recall
    from slam.report.trajectory_figure import save_png

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
