"""Training: `revisit vocabulary train` for visual words, and `revisit filter train` for the 3x3 matrix filter."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tomli_w
from numpy.typing import NDArray

from place_recognition.belief.matrix_filter import FilterConfig
from place_recognition.evaluation.ground_truth_files import array_names, read_array
from place_recognition.evaluation.revisit_ground_truth import load_truth
from place_recognition.image_processing.extractors import make_extractor
from place_recognition.image_processing.local_features import FeatureExtractor
from place_recognition.paradigms.matrix_filter_training import (
    TrainingSamples,
    collect_samples,
    reduce_to_sequences,
    train_filter,
)
from place_recognition.vocabulary.vocabulary import Vocabulary, save_vocabulary
from place_recognition.vocabulary.vocabulary_training import (
    DescriptorSample,
    VocabularyTrainingConfig,
    train_vocabulary,
)
from slam.datasets.dataset import DatasetSpec
from slam.datasets.formats.kitti_files import sequence_names
from slam.datasets.formats.recording import ImageDataset
from slam.datasets.formats.registry import open_images
from slam.errors import ConfigError, DataError, OutputError
from slam.io.files import atomic_writer, check_output_file

Progress = Callable[[int, int], None]

FILTER_PARADIGMS = ("sequence-histograms", "dynamic-sequences")  # that filter their similarity matrix


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
    check_output_file(options.out)
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


def _save(out: Path, vocabulary: Vocabulary) -> None:
    try:
        save_vocabulary(out, vocabulary)
    except OSError as error:
        reason = error.strerror or str(error)
        raise OutputError(f"{out}: cannot be written, {reason}; choose another folder or make room") from error


def train_filter_file(matrix: Path, truth: Path, out: Path, paradigm: str) -> str:
    """Train the filter of a sequence paradigm, write it as settings, and return a summary.

    Args:
        matrix: the matrix.npz that `revisit places` wrote for that paradigm.
        truth: ground truth of its images, .npz or .mat.
        out: TOML file for the option --config.
        paradigm: sequence-histograms or dynamic-sequences.

    Raises:
        ConfigError: the paradigm has no filter.
        DataError: a file is missing or damaged, or the two do not belong together.
        OutputError: the file cannot be written.
    """
    if paradigm not in FILTER_PARADIGMS:
        raise ConfigError(f"paradigm {paradigm!r}: expected one with a filter, {' or '.join(FILTER_PARADIGMS)}")
    check_output_file(out)
    samples = _load_samples(matrix, truth)
    try:
        learned = train_filter(samples)
    except ValueError as error:
        raise DataError(f"{matrix} and {truth}: {error}") from error
    with atomic_writer(out, "wb") as file:
        tomli_w.dump(_as_settings(learned, paradigm), file)
    return _describe(learned, samples, out)


def _load_samples(matrix: Path, truth: Path) -> TrainingSamples:
    similarities = read_similarities(matrix)
    try:
        return collect_samples(*reduce_to_sequences(similarities, load_truth(truth)))
    except (ValueError, OSError) as error:
        raise DataError(f"{matrix} and {truth}: {error}") from error


def read_similarities(path: Path) -> NDArray[np.float64]:
    """Read the similarities (N, N), row = query, column = earlier image, from the matrix.npz of `revisit places`.

    Raises:
        DataError: the file is missing or damaged, or its matrix was shrunk.
    """
    try:
        similarity, step = read_array(path, "similarity"), read_array(path, "step")
    except ValueError as error:
        raise DataError(f"{path}: expected the matrix.npz of revisit places, found {error}; write it again") from error
    if similarity is None or similarity.ndim != 2 or similarity.dtype.kind not in "biuf":
        names = ", ".join(array_names(path)) or "none"
        found = names if similarity is None else f"{similarity.shape} of {similarity.dtype}"
        raise DataError(
            f"{path}: expected an array named similarity, (N, N) numbers, found {found}; write it with: revisit places"
        )
    if step is not None and step.ravel().tolist() != [1]:
        raise DataError(f"{path}: expected a matrix of single images, found it shrunk; use a shorter recording")
    return np.asarray(similarity, np.float64)


def _as_settings(learned: FilterConfig, paradigm: str) -> dict[str, object]:
    section = {"kernel": [list(row) for row in learned.kernel], "threshold": learned.threshold}
    return {"places": {paradigm.replace("-", "_"): {"filter": section}}}


def _describe(learned: FilterConfig, samples: TrainingSamples, out: Path) -> str:
    kernel = np.array2string(np.array(learned.kernel), precision=2, suppress_small=True)
    response = samples.patches @ np.ravel(learned.kernel) >= learned.threshold
    found, wrong = int((response & samples.labels).sum()), int((response & ~samples.labels).sum())
    counts = f"{int(samples.labels.sum())} cells of revisits, {found} of them found; {wrong} others taken for one"
    return f"{kernel}\nthreshold {learned.threshold:.2f}; {counts}\n{out}: use it with --config {out}"
