"""Pipeline of `revisit places`: a recogniser without odometry, from images to beliefs, metrics and result files."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from place_recognition.evaluation.memory import MapSize, map_size
from place_recognition.evaluation.precision_recall import leave_out_tolerated
from place_recognition.evaluation.similarity_matrix import MatrixRecorder, SimilarityMatrix
from place_recognition.image_processing.local_features import FeatureCache, FeatureExtractor, LocalFeatures
from place_recognition.image_processing.static_regions import ImageMasks, MaskedExtractor, StaticRegionConfig
from place_recognition.paradigms.registry import ParadigmsConfig, with_preset
from place_recognition.recognizer import Belief, MatrixSink, TwoRecordingRecognizer, takes_color
from slam.components import build_control, build_extractor, build_recognizer
from slam.datasets.dataset import read_color
from slam.datasets.prefetch import ColorImages, Recording, has_color, prefetch
from slam.evaluation.place_metrics import DriveData, PlaceMetrics, evaluate_places
from slam.evaluation.revisit_truth_files import RevisitTruth
from slam.io.matches import write_curve, write_matches, write_matrix
from slam.io.metrics import write_metrics
from slam.pipeline.provenance import peak_memory_mb
from slam.pipeline.run_warnings import RunWarnings
from slam.timing import StageTimer, timed, timing_ms

Image = NDArray[np.uint8]
Recordings = tuple[Recording[Image], Recording[Image]]  # a query and its reference


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
        static_ratio: mean share of the images that was left out because it is static.
        resized: indices of the processed images that had another size than the first of all.
        interrupted: whether the user stopped the run.
        wall_seconds: time from the first image to the last belief, without the control's.
        control: beliefs of the control about the same images; None where it did not run.
        reference_images: number of images of the reference recording; None without one. All else is of the query: its
            images count from 0, and their matches from the first image of the reference.
        mapping_seconds: time that the reference took.
    """

    beliefs: list[Belief] = field(default_factory=list)
    stage_ms: list[dict[str, float]] = field(default_factory=list)
    rows: MatrixRecorder = field(default_factory=MatrixRecorder)
    size: MapSize | None = None
    static_ratio: float = 0.0
    resized: tuple[int, ...] = ()
    interrupted: bool = False
    wall_seconds: float = 0.0
    control: list[Belief] | None = None
    reference_images: int | None = None
    mapping_seconds: float = 0.0

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

    def extract(self, image: Image, mask: Image | None = None) -> LocalFeatures:
        """Return the features of a grey image (H, W) uint8 where the mask is not 0."""
        with self._clock.stage("features"):
            return self._inner.extract(image, mask)


class SameSizeImages:
    """Images of a recording, all in the size of the first: features of one place are alike at one scale only.

    Attributes:
        resized: indices of the images read so far that had another size.
    """

    def __init__(self, images: Recording[Image]) -> None:
        self.resized: set[int] = set()
        self._images = images
        self._shape: tuple[int, ...] | None = None

    def __len__(self) -> int:
        return len(self._images)

    def __getitem__(self, index: int) -> Image:
        """Read image (H, W) uint8."""
        if self._shape is None:
            self._shape = self._images[0].shape[:2]
        image = self._images[index]
        if image.shape[:2] == self._shape:
            return image
        self.resized.add(index)
        height, width = self._shape
        shrinks = image.shape[0] * image.shape[1] > height * width
        method = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
        return np.asarray(cv2.resize(image, (width, height), interpolation=method), np.uint8)


class JoinedImages:
    """The images of a reference recording and then those of the query."""

    def __init__(self, reference: Recording[Image], query: Recording[Image]) -> None:
        self._reference, self._query = reference, query

    def __len__(self) -> int:
        return len(self._reference) + len(self._query)

    def __getitem__(self, index: int) -> Image:
        """Read image (H, W) uint8."""
        begin = len(self._reference)
        return self._reference[index] if index < begin else self._query[index - begin]

    def read_color(self, index: int) -> Image | None:
        """Read image (H, W, 3), red first; None if it is grey."""
        begin = len(self._reference)
        return read_color(self._reference, index) if index < begin else read_color(self._query, index - begin)


class RecognizerFactory:
    """Makes recognisers of one paradigm; their feature extraction is timed separately.

    Attributes:
        clock: measures the stages.
        masks: masks of the recogniser that was made last.
    """

    def __init__(
        self,
        paradigm: str,
        config: ParadigmsConfig,
        control_seed: int | None = None,
        static_regions: StaticRegionConfig | None = None,
        mask: Image | None = None,
    ) -> None:
        """Choose what is made.

        Args:
            paradigm: name of the recogniser.
            config: settings of the paradigms.
            control_seed: seed of the control; None for a run without one.
            static_regions: how static regions are found; the defaults if None.
            mask: (H, W) uint8, 0 where features are left out of all images; None for nowhere.
        """
        self.clock = StageTimer()
        self.masks = ImageMasks()
        self._paradigm, self._config, self._control_seed = paradigm, with_preset(paradigm, config), control_seed
        self._static_regions, self._mask = static_regions, mask

    def make(self, rows: MatrixSink | None = None) -> TwoRecordingRecognizer:
        """Make a new recogniser.

        Raises:
            DataError: its vocabulary or descriptor file cannot be used.
        """
        return build_recognizer(self._paradigm, self._make_features(), self._config, rows)

    def make_with_control(self, rows: MatrixSink) -> tuple[TwoRecordingRecognizer, TwoRecordingRecognizer | None]:
        """Make a new recogniser, and the control with the same features of each image.

        Raises:
            DataError: its vocabulary or descriptor file cannot be used.
        """
        features = self._make_features()
        recognizer = build_recognizer(self._paradigm, features, self._config, rows)
        if self._control_seed is None:
            return recognizer, None
        return recognizer, build_control(features, self._config, self._control_seed)

    def _make_features(self) -> FeatureCache:
        self.masks = ImageMasks(self._static_regions, self._mask)
        extractor = MaskedExtractor(build_extractor(self._config), self.masks)
        return FeatureCache(TimedExtractor(extractor, self.clock))


class ControlRun:
    """Shows the control each image after the recogniser, outside the timing of the recogniser.

    Attributes:
        beliefs: its beliefs; None where there is no control.
        seconds: time that it took.
    """

    def __init__(self, control: TwoRecordingRecognizer | None, clock: StageTimer) -> None:
        self._control, self._clock = control, clock
        self.beliefs: list[Belief] | None = None if control is None else []
        self.seconds = 0.0

    def observe(self, index: int, image: Image) -> None:
        """Show it an image."""
        if self._control is not None:
            self._add(lambda control: control.observe(index, image, float("nan")))

    def end_reference(self) -> None:
        """Make the images so far its reference."""
        if self._control is not None:
            self._control.end_reference()
            self.beliefs, self.seconds = [], 0.0

    def finish(self) -> None:
        """Take its late beliefs."""
        if self._control is not None:
            self._add(lambda control: control.finish())

    def _add(self, answer: Callable[[TwoRecordingRecognizer], list[Belief]]) -> None:
        assert self._control is not None
        assert self.beliefs is not None
        start = time.perf_counter()
        self.beliefs += answer(self._control)
        self._clock.lap()  # features that only the control needed are not the recogniser's
        self.seconds += time.perf_counter() - start


def run_recognizer(
    images: Recording[Image],
    factory: RecognizerFactory,
    show_progress: Callable[[int, int], None],
    should_stop: Callable[[], bool],
    reference: Recording[Image] | None = None,
) -> PlaceRecognitionRun:
    """Run a recogniser once over all images, in order, without a measured distance.

    Args:
        images: images of the recording; a thread reads ahead, and resizes them to the size of the first of all.
        factory: makes the recogniser.
        show_progress: called after each image with the number of images done and their total number.
        should_stop: called after each image; returns whether to end the run there.
        reference: images of the recording with which those of `images` are matched; None to match them with earlier
            ones of their own.

    Raises:
        DataError: an image cannot be read, or the recogniser cannot be made (`RecognizerFactory.make`).
        KeyboardInterrupt: the run was to end before the first image after the reference.
    """
    begin = 0 if reference is None else len(reference)
    run = PlaceRecognitionRun(reference_images=None if reference is None else begin)
    joined = images if reference is None else JoinedImages(reference, images)
    _warm_up(joined, factory)
    recognizer, control = factory.make_with_control(run.rows)
    images = _as_seen(joined, recognizer)
    control_run, start = ControlRun(control, factory.clock), time.perf_counter()
    for index, image in enumerate(timed(prefetch(images), factory.clock)):
        if reference is not None and index == begin:
            run.mapping_seconds = time.perf_counter() - start - control_run.seconds
            _end_reference(run, recognizer, control_run, factory)
            start = time.perf_counter()
        with factory.clock.stage("place recognition"):
            run.beliefs += recognizer.observe(index, image, float("nan"))
        run.stage_ms.append(_subtract_features(factory.clock.lap()))
        control_run.observe(index, image)
        show_progress(index + 1, len(images))
        if should_stop():
            run.interrupted = True
            break
    if run.interrupted and index < begin:
        raise KeyboardInterrupt
    run.beliefs += recognizer.finish()
    control_run.finish()
    wall_seconds = time.perf_counter() - start - control_run.seconds
    return replace(
        run,
        beliefs=_count_from(run.beliefs, begin),
        size=map_size(recognizer),
        static_ratio=factory.masks.mean_static_ratio,
        resized=tuple(sorted(index - begin for index in images.resized if begin <= index < begin + run.images)),
        wall_seconds=wall_seconds,
        control=None if control_run.beliefs is None else _count_from(control_run.beliefs, begin),
    )


def _end_reference(
    run: PlaceRecognitionRun, recognizer: TwoRecordingRecognizer, control: ControlRun, factory: RecognizerFactory
) -> None:
    """Make the images so far the reference, and forget what was answered about them."""
    recognizer.end_reference()
    control.end_reference()
    factory.masks.end_reference()
    run.rows.end_reference(run.images)
    run.beliefs.clear()
    run.stage_ms.clear()


def _count_from(beliefs: list[Belief], begin: int) -> list[Belief]:
    """Return beliefs whose queries count from the image at index `begin`, and whose matches stay as they are."""
    return [
        replace(
            belief,
            query=belief.query - begin,
            answered_at=None if belief.answered_at is None else belief.answered_at - begin,
        )
        for belief in beliefs
    ]


def stage_times(run: PlaceRecognitionRun) -> dict[str, Array]:
    """Return the milliseconds (N,) of each stage for the N images."""
    stages = dict.fromkeys(stage for spent in run.stage_ms for stage in spent)
    return {stage: np.array([spent.get(stage, 0.0) for spent in run.stage_ms]) for stage in stages}


def _warm_up(images: Recording[Image], factory: RecognizerFactory) -> None:
    """Compile all kernels on a second recogniser, so that the timer measures recognition alone."""
    recognizer = factory.make()
    seen = _as_seen(images, recognizer)
    for index in range(min(_WARM_UP_IMAGES, len(seen))):
        recognizer.observe(index, seen[index], float("nan"))
    factory.clock.lap()


def _as_seen(images: Recording[Image], recognizer: TwoRecordingRecognizer) -> SameSizeImages:
    """Return the images in one size, in colour where the recogniser sees it and the recording has it."""
    return SameSizeImages(ColorImages(images) if takes_color(recognizer) and has_color(images) else images)


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
        truth: (N, N) ground truth of the N processed images, or None; (N, M) with M images of a reference.
        metrics: content of metrics.json.
        remark: what the user should know about the images; empty for nothing.
        tolerated: (N, M) pairs that count neither as right nor as wrong; None for none.
    """

    name: str
    beliefs: tuple[Belief, ...]
    result: PlaceMetrics
    matrices: dict[str, SimilarityMatrix]
    truth: NDArray[np.bool_] | None
    metrics: dict[str, object]
    remark: str = ""
    tolerated: NDArray[np.bool_] | None = None

    @property
    def detections(self) -> NDArray[np.int64]:
        """(K, 2) query and match of the accepted beliefs."""
        pairs = [(belief.query, belief.match) for belief in self.beliefs if belief.accepted]
        return np.array(pairs, np.int64).reshape(-1, 2)


def make_record(
    run: PlaceRecognitionRun, truth: RevisitTruth, drive: DriveData, provenance: dict[str, object]
) -> PlacesRecord:
    """Gather the results of a run and measure them.

    Args:
        run: beliefs, times and matrices.
        truth: ground truth of the whole recording.
        drive: times and path lengths of the whole recording.
        provenance: source, settings and versions, for metrics.json.
    """
    columns = run.images if run.reference_images is None else run.reference_images
    seen_truth = None if truth.matrix is None else truth.matrix[: run.images, :columns]
    paradigm = str(provenance["paradigm"])
    beliefs = tuple(sorted(run.beliefs, key=lambda belief: belief.query))
    counted = leave_out_tolerated(beliefs, truth.tolerated)
    control = None if run.control is None else leave_out_tolerated(run.control, truth.tolerated)
    result = evaluate_places(paradigm, counted, seen_truth, run.size, drive, control)
    stages = ("similarity", *(stage for stage in run.rows.stages if stage != "similarity"))
    return PlacesRecord(
        name=f"{_name_recordings(provenance)}: {paradigm}",
        beliefs=beliefs,
        result=result,
        matrices={stage: run.rows.matrix(run.images, stage) for stage in stages},
        truth=seen_truth,
        metrics=provenance | _measure(run, result, truth),
        remark=_describe_sizes(run),
        tolerated=truth.tolerated,
    )


def _name_recordings(provenance: dict[str, object]) -> str:
    name = f"{Path(str(provenance['source'])).resolve().name} {provenance['sequence']}"
    if "reference_source" not in provenance:
        return name
    return f"{name} against {Path(str(provenance['reference_source'])).resolve().name}"


def _describe_sizes(run: PlaceRecognitionRun) -> str:
    if not run.resized:
        return ""
    first = "the first" if run.reference_images is None else "the reference"
    return f"{len(run.resized)} images were resized to the size of {first}; image {run.resized[0]} is the first of them"


def _measure(run: PlaceRecognitionRun, result: PlaceMetrics, truth: RevisitTruth) -> dict[str, object]:
    reference = {"frames": run.reference_images, "mapping_seconds": run.mapping_seconds}
    return {
        "frames": run.images,
        **({} if run.reference_images is None else {"reference": reference}),
        "static_ratio": run.static_ratio,
        "images_resized": len(run.resized),
        "ground_truth": truth.origin,
        "places": result.section,
        "timing_ms": timing_ms(stage_times(run)),
        "frames_per_second": run.images / run.wall_seconds,
        "wall_seconds": run.wall_seconds,
        "peak_memory_mb": peak_memory_mb(),
        "interrupted": run.interrupted,
        "notes": result.notes,
    }


def write_results(
    folder: Path, record: PlacesRecord, warnings: RunWarnings, pictures: Recordings | None = None
) -> None:
    """Write every result file into a folder. A picture or matrix that fails is left out, with a warning.

    Args:
        folder: where to.
        record: what is written.
        warnings: takes the warnings.
        pictures: images of a query and its reference, for a sheet of matches; None to draw none.

    Raises:
        OutputError: not even the matches and the metrics can be written.
    """
    write_matches(folder / "matches.csv", record.beliefs)
    write_metrics(folder / "metrics.json", record.metrics)
    files: dict[str, Callable[[Path], None]] = {
        "precision_recall.csv": lambda path: write_curve(path, record.result.curve),
        "matrix.npz": lambda path: _write_matrices(path, record),
        "precision_recall.png": lambda path: _draw_curve(path, record),
        "matrix.png": lambda path: _draw_matrices(path, record),
        "stages.png": lambda path: _draw_stages(path, record),
    }
    if pictures is not None:
        files["matches.png"] = lambda path: _draw_matches(path, record, pictures)
    for name, write in files.items():
        if not warnings.attempt_to(name, partial(write, folder / name)):
            (folder / name).unlink(missing_ok=True)  # half a file is none
    last = partial(write_metrics, folder / "metrics.json", record.metrics)
    warnings.attempt_to("metrics.json with the last warnings", last)


def _write_matrices(path: Path, record: PlacesRecord) -> None:
    arrays: dict[str, NDArray[np.generic]] = {stage: matrix.values for stage, matrix in record.matrices.items()}
    step = np.array(record.matrices["similarity"].step)
    write_matrix(path, arrays | {"detections": record.detections, "step": step})


def _draw_curve(path: Path, record: PlacesRecord) -> None:
    from slam.report.place_recognition_figures import plot_precision_recall
    from slam.report.style import save_png

    curves = {} if record.result.curve is None else {str(record.metrics["paradigm"]): record.result.curve}
    save_png(plot_precision_recall(curves, record.name), path)


def _draw_matrices(path: Path, record: PlacesRecord) -> None:
    from slam.report.place_recognition_figures import plot_places
    from slam.report.style import save_png

    columns = "reference image" if "reference" in record.metrics else "earlier image"
    detections = record.detections
    if record.tolerated is not None:
        detections = detections[~record.tolerated[detections[:, 0], detections[:, 1]]]
    save_png(plot_places(record.name, record.matrices, detections, record.truth, columns), path)


def _draw_matches(path: Path, record: PlacesRecord, pictures: Recordings) -> None:
    from slam.report.match_pictures import plot_matches
    from slam.report.style import save_png

    figure = plot_matches(record.name, record.beliefs, pictures, record.truth, record.tolerated)
    save_png(figure, path)


def _draw_stages(path: Path, record: PlacesRecord) -> None:
    from slam.report.place_recognition_figures import plot_stages
    from slam.report.style import save_png

    result = record.result
    save_png(plot_stages(result.stages, result.control, result.reliability, record.name), path)
