"""`revisit vocabulary train`: folders of images in, a file of visual words out."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from place_recognition.image_processing.extractors import make_extractor
from place_recognition.image_processing.features import FeatureExtractor
from place_recognition.map.vocabulary import Vocabulary, save_vocabulary
from place_recognition.map.vocabulary_training import DescriptorSample, TrainingConfig, train_vocabulary
from slam.datasets.kitti_files import sequence_names
from slam.datasets.left_images import ImageRecording
from slam.datasets.open import open_left_images
from slam.datasets.source import Source
from slam.errors import ConfigError, DataError, OutputError

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class TrainingOptions:
    """What to train on, with which features, and the file for the words.

    Attributes:
        sources: recordings of any kind; of folders in KITTI layout all sequences are taken.
        out: the file.
        features: name in EXTRACTORS of place_recognition.
    """

    sources: tuple[Path, ...]
    out: Path
    features: str = "surf"


def train_from_images(options: TrainingOptions, settings: dict[str, int], progress: Progress) -> str:
    """Train a vocabulary on all images of the sources, write it, and say in one line what came of it.

    Args:
        options: what, and where to.
        settings: fields of TrainingConfig.
        progress: told images done and in all.

    Raises:
        ConfigError: unknown features, or settings that cannot work.
        DataError: a source without images, an unreadable image, or fewer descriptors than words.
        OutputError: the file cannot be written; a missing folder is found out before the work begins.
    """
    extractor, config = _extractor(options.features), _config(settings)
    recordings = [recording for source in options.sources for recording in _recordings(source)]
    _check_folder(options.out)
    sample, count = DescriptorSample(config.sample, config.seed), sum(map(len, recordings))
    images = (recording[index] for recording in recordings for index in range(len(recording)))
    for done, image in enumerate(images):
        sample.add(extractor.extract(image).descriptors)
        progress(done + 1, count)
    try:
        vocabulary = train_vocabulary(extractor.kind, sample.descriptors, config)
    except ValueError as error:
        raise DataError(f"{options.sources[0]}: {error}") from error
    _save(options.out, vocabulary)
    return (
        f"{options.out}: {len(vocabulary)} words of {vocabulary.kind} from {sample.seen} descriptors of {count} images"
    )


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


def _recordings(source: Path) -> list[ImageRecording]:
    names = sequence_names(source) or (None,)
    # a word does not ask when it was seen: any images a second will do
    return [open_left_images(Source(source, name, fps=1.0)) for name in names]


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
