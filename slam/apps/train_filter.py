"""`revisit filter train`: trains the 3x3 matrix filter on a matrix and its ground truth, and writes it as settings."""

from pathlib import Path

import numpy as np
import tomli_w
from numpy.typing import NDArray

from place_recognition.belief.matrix_filter import FilterConfig
from place_recognition.belief.matrix_filter_training import Samples, collect_samples, reduce_to_sequences, train_filter
from place_recognition.evaluation.ground_truth import load_truth
from place_recognition.evaluation.ground_truth_files import array_names, read_array
from slam.errors import ConfigError, DataError
from slam.io.atomic import atomic_writer

PARADIGMS = ("sequence-histograms", "dynamic-sequences")


def train_filter_file(matrix: Path, truth: Path, out: Path, paradigm: str) -> str:
    """Train the filter of a paradigm of sequences, write it as settings, and return a summary.

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
    if paradigm not in PARADIGMS:
        raise ConfigError(f"paradigm {paradigm!r}: expected one with a filter, {' or '.join(PARADIGMS)}")
    samples = _load_samples(matrix, truth)
    try:
        learned = train_filter(samples)
    except ValueError as error:
        raise DataError(f"{matrix} and {truth}: {error}") from error
    with atomic_writer(out, "wb") as file:
        tomli_w.dump(_as_settings(learned, paradigm), file)
    return _describe(learned, samples, out)


def _load_samples(matrix: Path, truth: Path) -> Samples:
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
        raise DataError(f"{path}: expected a matrix of single images, found it shrunk; use a shorter drive")
    return np.asarray(similarity, np.float64)


def _as_settings(learned: FilterConfig, paradigm: str) -> dict[str, object]:
    section = {"kernel": [list(row) for row in learned.kernel], "threshold": learned.threshold}
    return {"places": {paradigm.replace("-", "_"): {"filter": section}}}


def _describe(learned: FilterConfig, samples: Samples, out: Path) -> str:
    kernel = np.array2string(np.array(learned.kernel), precision=2, suppress_small=True)
    response = samples.patches @ np.ravel(learned.kernel) >= learned.threshold
    found, wrong = int((response & samples.labels).sum()), int((response & ~samples.labels).sum())
    counts = f"{int(samples.labels.sum())} cells of revisits, {found} of them found; {wrong} others taken for one"
    return f"{kernel}\nthreshold {learned.threshold:.2f}; {counts}\n{out}: use it with --config {out}"
