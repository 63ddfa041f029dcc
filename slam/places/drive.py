"""One drive through a recogniser: images in, beliefs out."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from place_recognition.evaluation.map_size import MapSize, map_size
from place_recognition.evaluation.matrix import MatrixRecorder
from place_recognition.image_processing.features import FeatureCache, FeatureExtractor, LocalFeatures
from place_recognition.paradigms.catalogue import ParadigmsConfig, local_features
from place_recognition.recognizer import Belief, PlaceRecognizer, RowSink
from slam.clock import StageTimer, timed
from slam.datasets.prefetch import Recording, prefetch
from slam.parts import build_recognizer

Image = NDArray[np.uint8]
Array = NDArray[np.float64]

_WARM_UP_IMAGES = 3


@dataclass
class Recognised:
    """What became of a drive.

    Attributes:
        beliefs: one for each image seen, in the order in which they came.
        stage_ms: milliseconds by stage, an entry for each image.
        rows: the matrices.
        size: of the map in the end.
        interrupted: the user stopped it.
        wall_seconds: from the first image to the last belief.
    """

    beliefs: list[Belief] = field(default_factory=list)
    stage_ms: list[dict[str, float]] = field(default_factory=list)
    rows: MatrixRecorder = field(default_factory=MatrixRecorder)
    size: MapSize | None = None
    interrupted: bool = False
    wall_seconds: float = 0.0

    @property
    def images(self) -> int:
        """Images seen."""
        return len(self.stage_ms)


class ClockedExtractor:
    """Counts the time of another extractor as the stage `features` (a FeatureExtractor)."""

    def __init__(self, inner: FeatureExtractor, clock: StageTimer) -> None:
        self._inner, self._clock = inner, clock

    @property
    def kind(self) -> str:
        """Name of the descriptor."""
        return self._inner.kind

    def extract(self, image: Image) -> LocalFeatures:
        """Features of a grey image (H, W) uint8."""
        with self._clock.stage("features"):
            return self._inner.extract(image)


class Bench:
    """Builds recognisers of one paradigm whose features and time are accounted for."""

    def __init__(self, paradigm: str, config: ParadigmsConfig) -> None:
        self.clock = StageTimer()
        self._paradigm, self._config = paradigm, config

    def build(self, rows: RowSink | None = None) -> PlaceRecognizer:
        """A recogniser that has seen nothing.

        Raises:
            DataError: its vocabulary or its descriptor cannot serve.
        """
        features = FeatureCache(ClockedExtractor(local_features(self._config), self.clock))
        return build_recognizer(self._paradigm, features, self._config, rows)


def recognise(
    images: Recording[Image], bench: Bench, show: Callable[[int, int], None], stop: Callable[[], bool]
) -> Recognised:
    """Drive through all images, once, in order, with nothing known of the way.

    Args:
        images: read ahead by a thread.
        bench: what to drive with.
        show: told how many images of how many are done.
        stop: asked after each image whether to end the drive there.

    Raises:
        DataError: an image cannot be read, or see `Bench.build`.
    """
    _warm_up(images, bench)
    done = Recognised()
    recognizer, start = bench.build(done.rows), time.perf_counter()
    for index, image in enumerate(timed(prefetch(images), bench.clock)):
        with bench.clock.stage("place recognition"):
            done.beliefs += recognizer.observe(index, image, float("nan"))
        done.stage_ms.append(_apart(bench.clock.lap()))
        show(index + 1, len(images))
        if stop():
            done.interrupted = True
            break
    done.beliefs += recognizer.finish()
    return replace(done, size=map_size(recognizer), wall_seconds=time.perf_counter() - start)


def stage_times(done: Recognised) -> dict[str, Array]:
    """Milliseconds of each stage for each image (N,)."""
    stages = dict.fromkeys(stage for spent in done.stage_ms for stage in spent)
    return {stage: np.array([spent.get(stage, 0.0) for spent in done.stage_ms]) for stage in stages}


def _warm_up(images: Recording[Image], bench: Bench) -> None:
    """Have everything compiled, so that the clock counts recognition alone."""
    recognizer = bench.build()
    for index in range(min(_WARM_UP_IMAGES, len(images))):
        recognizer.observe(index, images[index], float("nan"))
    bench.clock.lap()


def _apart(spent: dict[str, float]) -> dict[str, float]:
    """Take the features, which a recogniser asks for from within, out of its own time."""
    return spent | {"place recognition": spent["place recognition"] - spent.get("features", 0.0)}
