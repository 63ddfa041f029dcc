"""Reliability of probabilities: of the matches that are given 0.9, nine in ten should be true."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from place_recognition.evaluation.precision_recall import is_correct
from place_recognition.recognizer import Belief

Array = NDArray[np.float64]

# Ten equal bins, the last of which is split where loops are accepted: the tenth would hide what 0.999 means.
BIN_EDGES = (*(k / 10 for k in range(10)), 0.99, 0.999, 1.0)
SURE_PROBABILITY = 0.999


@dataclass(frozen=True)
class Reliability:
    """Reliability table of probabilities.

    Attributes:
        counts: (B,) number of matches with a probability in each bin of BIN_EDGES; a bin holds its lower edge, and
            the last one its upper edge too.
        mean_probabilities: (B,) their mean probability; NaN in an empty bin.
        true_shares: (B,) share of them that is true; NaN in an empty bin.
        sure: number of matches whose probability is at least SURE_PROBABILITY.
        sure_false: number of false ones among these.
    """

    counts: NDArray[np.int64]
    mean_probabilities: Array
    true_shares: Array
    sure: int
    sure_false: int

    @property
    def expected_calibration_error(self) -> float:
        """Mean difference between probability and share of true matches over the bins, weighted by their counts."""
        error = np.abs(self.mean_probabilities - self.true_shares)
        return float(np.nansum(error * self.counts) / self.counts.sum())


def measure_reliability(beliefs: Sequence[Belief], truth: NDArray[np.bool_], tolerance: int = 0) -> Reliability | None:
    """Compare the probabilities of matches with the truth; None where no match has a probability.

    Args:
        beliefs: one belief for each query; accepted or not, each match with a probability counts.
        truth: (N, N) truth matrix, row = query, column = earlier image.
        tolerance: images by which a match may miss a true one, as in `is_correct`.
    """
    stated = [b for b in beliefs if b.match is not None and b.probability is not None]
    if not stated:
        return None
    probabilities = np.array([b.probability for b in stated], np.float64)
    right = is_correct(stated, truth, tolerance)
    bins = np.searchsorted(BIN_EDGES[1:-1], probabilities, side="right")

    def total(values: NDArray[np.generic] | None = None) -> NDArray[np.generic]:
        return np.bincount(bins, values, minlength=len(BIN_EDGES) - 1)

    counts = total().astype(np.int64)
    filled = np.where(counts > 0, counts, np.nan)
    sure = probabilities >= SURE_PROBABILITY
    return Reliability(
        counts, total(probabilities) / filled, total(right) / filled, int(sure.sum()), int((sure & ~right).sum())
    )
