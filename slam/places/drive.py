"""Runs a recogniser over a recording: images in, beliefs and stage times out."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from place_recognition.evaluation.map_size import MapSize, map_size
from place_recognition.evaluation.matrix import MatrixRecorder
from place_recognition.image_processing.features import FeatureCache, FeatureExtractor, LocalFeatures
from place_recognition.paradigms.catalogue import ParadigmsConfig, make_feature_extractor
from place_recognition.recognizer import Belief, MatrixSink, PlaceRecognizer
from slam.clock import StageTimer, timed
from slam.datasets.prefetch import Recording, prefetch
from slam.parts import build_recognizer

Image = NDArray[np.uint8]
Array = NDArray[np.float64]

_WARM_UP_IMAGES = 3  # enough that every numba kernel is compiled before the clock starts


@dataclass
class PlaceRecognitionRun:
    """Everything that a run of a recogniser over a recording gave.

    Attributes:
        beliefs: one for each image seen, in the order in which they became ready.
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
        """Number of images seen."""
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
    """Makes recognisers of one paradigm whose feature extraction is timed apart."""

    def __init__(self, paradigm: str, config: ParadigmsConfig) -> None:
        self.clock = StageTimer()
        self._paradigm, self._config = paradigm, config

    def make(self, rows: MatrixSink | None = None) -> PlaceRecognizer:
        """Make a recogniser that has seen nothing.

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
    """Have all kernels compiled on a second recogniser, so that the clock measures recognition alone."""
    recognizer = factory.make()
    for index in range(min(_WARM_UP_IMAGES, len(images))):
        recognizer.observe(index, images[index], float("nan"))
    factory.clock.lap()


def _subtract_features(spent: dict[str, float]) -> dict[str, float]:
    """Subtract the time of the features, which the recogniser extracts inside `observe`, from its own time."""
    return spent | {"place recognition": spent["place recognition"] - spent.get("features", 0.0)}
