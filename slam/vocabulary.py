"""`revisit vocabulary train`: folders of images in, a file of visual words out."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.extractors import make_extractor
from place_recognition.image_processing.features import FeatureExtractor
from place_recognition.map.vocabulary import Vocabulary, save_vocabulary
from place_recognition.map.vocabulary_training import DescriptorSample, TrainingConfig, train_vocabulary
from slam.datasets.kitti_files import sequence_names
from slam.datasets.left_images import ImageDataset
from slam.datasets.open import open_images
from slam.datasets.source import DatasetSpec
from slam.engine.choice import choose_engine
from slam.engine.engine import Engine
from slam.errors import ConfigError, DataError, OutputError

Progress = Callable[[int, int], None]
Floats = NDArray[np.float32]

IMAGES = 32  # described at a time: seconds of work for one opening of the recording


@dataclass(frozen=True)
class TrainingOptions:
    """What to train on, with which features, and the file for the words.

    Attributes:
        sources: recordings of any kind; of folders in KITTI layout all sequences are taken.
        out: the file.
        features: name in EXTRACTORS of place_recognition.
        workers: processes on this machine; 0 or None for this one alone.
        scheduler: address of a dask scheduler to use instead.
    """

    sources: tuple[Path, ...]
    out: Path
    features: str = "surf"
    workers: int | None = None
    scheduler: str | None = None


@dataclass(frozen=True)
class Stretch:
    """Consecutive images of a recording: those from begin to before end."""

    source: DatasetSpec
    begin: int
    end: int


class Describer:
    """Gives the descriptors of each image of a stretch. Whoever it is sent to opens the recordings there."""

    def __init__(self, features: str, recordings: Mapping[DatasetSpec, ImageDataset]) -> None:
        """Check the features.

        Args:
            features: name in EXTRACTORS of place_recognition.
            recordings: those that are open already.

        Raises:
            ConfigError: unknown features.
        """
        self._features, self._recordings = features, recordings
        self._extractor = _extractor(features)

    @property
    def kind(self) -> str:
        """Of the features."""
        return self._extractor.kind

    def __reduce__(self) -> tuple[type["Describer"], tuple[str, dict[DatasetSpec, ImageDataset]]]:
        """How it is sent: without what is open here."""
        return Describer, (self._features, {})

    def __call__(self, stretch: Stretch) -> list[Floats]:
        """The descriptors (N, D) of each image.

        Raises:
            DataError: the recording or an image cannot be read.
        """
        recording = self._recordings.get(stretch.source)
        if recording is None:
            recording = open_images(stretch.source)
        return [self._extractor.extract(recording[index]).descriptors for index in range(stretch.begin, stretch.end)]


def train_from_images(options: TrainingOptions, settings: dict[str, int], progress: Progress) -> str:
    """Train a vocabulary on all images of the sources, write it, and say in one line what came of it.

    The file is the same whatever the engine.

    Args:
        options: what, on what, and where to.
        settings: fields of TrainingConfig.
        progress: told images done and in all.

    Raises:
        ConfigError: unknown features, or settings or an engine that cannot work.
        DataError: a source without images, an unreadable image, or fewer descriptors than words.
        EngineError: whatever did a part of the work died.
        OutputError: the file cannot be written; a missing folder is found out before the work begins.
    """
    config, engine = _config(settings), choose_engine(options.workers, options.scheduler, 0)
    recordings = {known: open_images(known) for source in options.sources for known in _drives(source)}
    describer = Describer(options.features, recordings)
    _check_folder(options.out)
    with engine:
        sample = _sample(recordings, describer, config, engine, progress)
        try:
            vocabulary = _train(describer.kind, sample, config, engine, options.out)
        except ValueError as error:
            raise DataError(f"{options.sources[0]}: {error}") from error
    _save(options.out, vocabulary)
    images = sum(map(len, recordings.values()))
    return (
        f"{options.out}: {len(vocabulary)} words of {vocabulary.kind} from {sample.seen} descriptors of {images} images"
    )


def _sample(
    recordings: Mapping[DatasetSpec, ImageDataset],
    describer: Describer,
    config: TrainingConfig,
    engine: Engine,
    progress: Progress,
) -> DescriptorSample:
    """Of all images, seen in their order whoever describes them."""
    sample, count = DescriptorSample(config.sample, config.seed), sum(map(len, recordings.values()))
    stretches = [stretch for source, recording in recordings.items() for stretch in _stretches(source, len(recording))]
    images = chain.from_iterable(engine.map(describer, stretches))
    for done, descriptors in enumerate(images, start=1):
        sample.add(descriptors)
        progress(done, count)
    return sample


def _stretches(source: DatasetSpec, images: int) -> list[Stretch]:
    return [Stretch(source, begin, min(begin + IMAGES, images)) for begin in range(0, images, IMAGES)]


def _extractor(name: str) -> FeatureExtractor:
    try:
        return make_extractor(name)
    except ValueError as error:
        raise ConfigError(str(error)) from error


def _config(settings: dict[str, int]) -> TrainingConfig:
    try:
        return TrainingConfig(**settings)
    except ValueError as error:
        raise ConfigError(str(error)) from error


def _drives(source: Path) -> list[DatasetSpec]:
    names = sequence_names(source) or (None,)
    # a word does not ask when it was seen: any images a second will do
    return [DatasetSpec(source.absolute(), name, fps=1.0) for name in names]


def _train(kind: str, sample: DescriptorSample, config: TrainingConfig, engine: Engine, out: Path) -> Vocabulary:
    with _scratch(out) as folder:
        return train_vocabulary(kind, engine.share(sample.descriptors, folder), config, engine.map)


@contextmanager
def _scratch(out: Path) -> Iterator[Path]:
    """A folder beside the file, for what all who work must see; it goes with the block."""
    try:
        with TemporaryDirectory(prefix=f".{out.name}-", dir=out.absolute().parent) as folder:
            yield Path(folder)
    except OSError as error:
        raise OutputError(
            f"{out}: expected a folder that can be written, and read by all workers, found {error.strerror or error};"
            " choose another"
        ) from error


def _check_folder(out: Path) -> None:
    if out.is_dir() or not out.absolute().parent.is_dir():
        found = "a folder" if out.is_dir() else "no such folder"
        raise OutputError(f"{out}: expected a file to write in a folder that exists, found {found}; choose another")


def _save(out: Path, vocabulary: Vocabulary) -> None:
    try:
        save_vocabulary(out, vocabulary)
    except OSError as error:
        reason = error.strerror or str(error)
        raise OutputError(f"{out}: cannot be written, {reason}; choose another folder or make room") from error
