"""`revisit filter train`: a matrix and its truth in, a filter that fits the features and the vocabulary out."""

from pathlib import Path

import numpy as np
import tomli_w
from numpy.typing import NDArray

from place_recognition.belief.filter_training import Samples, samples_of, sequence_matrix, train_filter
from place_recognition.belief.matrix_filter import FilterConfig
from place_recognition.evaluation.array_file import array_names, read_array
from place_recognition.evaluation.ground_truth import load_truth
from slam.errors import ConfigError, DataError
from slam.storage.atomic import atomic_writer

PARADIGMS = ("sequence-histograms", "dynamic-sequences")


def train_filter_file(matrix: Path, truth: Path, out: Path, paradigm: str) -> str:
    """Learn the filter of a paradigm of sequences, write it as settings, and say what was learnt.

    Args:
        matrix: the matrix.npz that `revisit places` wrote for that paradigm.
        truth: which of its images show one place, .npz or .mat.
        out: TOML file for the option --config.
        paradigm: sequence-histograms or dynamic-sequences.

    Raises:
        ConfigError: another paradigm.
        DataError: a file is missing or damaged, or the two do not belong together.
        OutputError: the file cannot be written.
    """
    if paradigm not in PARADIGMS:
        raise ConfigError(f"paradigm {paradigm!r}: expected one with a filter, {' or '.join(PARADIGMS)}")
    samples = _samples(matrix, truth)
    try:
        learnt = train_filter(samples)
    except ValueError as error:
        raise DataError(f"{matrix} and {truth}: {error}") from error
    with atomic_writer(out, "wb") as file:
        tomli_w.dump(_settings(learnt, paradigm), file)
    return _summary(learnt, samples, out)


def _samples(matrix: Path, truth: Path) -> Samples:
    similarities = read_similarities(matrix)
    try:
        return samples_of(*sequence_matrix(similarities, load_truth(truth)))
    except (ValueError, OSError) as error:
        raise DataError(f"{matrix} and {truth}: {error}") from error


def read_similarities(path: Path) -> NDArray[np.float64]:
    """Similarity of each image (row) to the earlier ones (columns), (N, N), from the matrix.npz of `revisit places`.

    Raises:
        DataError: the file is missing, damaged, or shows a matrix that was shrunk.
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
        raise DataError(f"{path}: expected a matrix of single images, found it shrunk; use a shorter drive")
    return np.asarray(similarity, np.float64)


def _settings(learnt: FilterConfig, paradigm: str) -> dict[str, object]:
    section = {"kernel": [list(row) for row in learnt.kernel], "threshold": learnt.threshold}
    return {"places": {paradigm.replace("-", "_"): {"filter": section}}}


def _summary(learnt: FilterConfig, samples: Samples, out: Path) -> str:
    kernel = np.array2string(np.array(learnt.kernel), precision=2, suppress_small=True)
    response = samples.patches @ np.ravel(learnt.kernel) >= learnt.threshold
    found, wrong = int((response & samples.labels).sum()), int((response & ~samples.labels).sum())
    counts = f"{int(samples.labels.sum())} cells of revisits, {found} of them found; {wrong} others taken for one"
    return f"{kernel}\nthreshold {learnt.threshold:.2f}; {counts}\n{out}: use it with --config {out}"
