"""`revisit vocabulary train`: train visual words on folders of images, and write them to a file."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from place_recognition.image_processing.local_features import FeatureExtractor
from place_recognition.image_processing.registry import make_extractor
from place_recognition.vocabulary.training import DescriptorSample, VocabularyTrainingConfig, train_vocabulary
from place_recognition.vocabulary.vocabulary import Vocabulary, save_vocabulary
from slam.datasets.dataset import DatasetSpec
from slam.datasets.formats.kitti_files import sequence_names
from slam.datasets.formats.recording import ImageDataset
from slam.datasets.formats.registry import open_images
from slam.errors import ConfigError, DataError, OutputError

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class TrainingOptions:
    """Images to train on, their features, and the file of words.

    Attributes:
        sources: recordings of any format; of folders in KITTI layout all sequences are used.
        out: vocabulary file to write.
        features: name of the local features in EXTRACTORS of place_recognition.
    """

    sources: tuple[Path, ...]
    out: Path
    features: str = "surf"


def train_from_images(options: TrainingOptions, settings: dict[str, int], progress: Progress) -> str:
    """Train a vocabulary on all images of the sources, write it, and return a line of summary.

    Args:
        options: images, features and file.
        settings: fields of VocabularyTrainingConfig.
        progress: called after each image with the number of images done and of all.

    Raises:
        ConfigError: unknown features, or settings that cannot work.
        DataError: a source without images, an unreadable image, or fewer descriptors than words.
        OutputError: the file cannot be written; a missing folder is found before the work begins.
    """
    config, extractor = _make_config(settings), _make_extractor(options.features)
    recordings = [open_images(source) for folder in options.sources for source in _sequences(folder)]
    _check_folder(options.out)
    sample = _sample_descriptors(recordings, extractor, config, progress)
    try:
        vocabulary = train_vocabulary(extractor.kind, sample.descriptors, config)
    except ValueError as error:
        raise DataError(f"{options.sources[0]}: {error}") from error
    _save(options.out, vocabulary)
    images = sum(map(len, recordings))
    return (
        f"{options.out}: {len(vocabulary)} words of {vocabulary.kind} from {sample.seen} descriptors of {images} images"
    )


def _sample_descriptors(
    recordings: Sequence[ImageDataset],
    extractor: FeatureExtractor,
    config: VocabularyTrainingConfig,
    progress: Progress,
) -> DescriptorSample:
    sample, done, count = DescriptorSample(config.sample, config.seed), 0, sum(map(len, recordings))
    for recording in recordings:
        for index in range(len(recording)):
            sample.add(extractor.extract(recording[index]).descriptors)
            done += 1
            progress(done, count)
    return sample


def _make_extractor(name: str) -> FeatureExtractor:
    try:
        return make_extractor(name)
    except ValueError as error:
        raise ConfigError(str(error)) from error


def _make_config(settings: dict[str, int]) -> VocabularyTrainingConfig:
    try:
        return VocabularyTrainingConfig(**settings)
    except ValueError as error:
        raise ConfigError(str(error)) from error


def _sequences(folder: Path) -> list[DatasetSpec]:
    """List the recordings in a folder: all sequences of KITTI layout, or the folder itself."""
    names = sequence_names(folder) or (None,)
    # Words do not depend on the times of the images, so any frame rate will do.
    return [DatasetSpec(folder.absolute(), name, fps=1.0) for name in names]


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
