"""Votes of an image's descriptors for the locations of a map of words, and how unlikely they are by chance.

Tsintotas, Bampis, Gasteratos, RA-L 4(2) 2019, section III-C, equations 4 to 6.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, xlog1py, xlogy

from place_recognition.map.tracked_words import WordMap

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Ballot:
    """What one image's descriptors voted for: only the locations that have votes.

    Attributes:
        locations: (V,) increasing.
        votes: (V,) int64, votes of each, at least one.
        expected: (V,) votes expected if words were hit at random.
        log_density: (V,) natural logarithm of the binomial probability of just these votes.
    """

    locations: Indices
    votes: Indices
    expected: Array
    log_density: Array

    def best(self, log_threshold: float) -> int | None:
        """Row of the location with the most votes among those less likely than the threshold, or among all if none is.

        Only locations with more votes than expected count. Of equal ones the least likely, then the earliest.
        """
        above = np.flatnonzero(self.votes > self.expected)
        if len(above) == 0:
            return None
        passing = above[self.log_density[above] < log_threshold]
        candidates = passing if len(passing) else above
        order = np.lexsort((self.log_density[candidates], -self.votes[candidates]))
        return int(candidates[order[0]])


def count_votes(hit: Indices, words: WordMap) -> Ballot:
    """Let each word hit, given as distinct indices (N,), vote once for each location where it was seen.

    Each location is hit with probability p = its words / all words (eq. 5); its votes are binomial (eq. 4). In the
    paper a word votes as often as it is hit. But what makes many descriptors of an image hit one word, a repeated
    window or the sky, is no chance of its own each time, and the binomial test would take them for independent.
    """
    locations, votes = np.unique(covered(words.spans(hit)), return_counts=True)
    share = words.covering(locations) / max(words.past, 1)
    return Ballot(locations, votes, len(hit) * share, log_binomial(votes, len(hit), share))


def covered(spans: NDArray[np.int32]) -> Indices:
    """All locations of spans (K, 2), both ends included, one span after the other."""
    lengths = spans[:, 1] - spans[:, 0] + 1
    begins = np.cumsum(lengths) - lengths
    return np.arange(lengths.sum(), dtype=np.int64) + np.repeat(spans[:, 0] - begins, lengths)


def log_binomial(successes: Indices, trials: int, probability: Array) -> Array:
    """Natural logarithm of C(n, x) p^x (1 - p)^(n - x), elementwise; -inf for what cannot happen."""
    x = np.asarray(successes, dtype=np.float64)
    choices = gammaln(trials + 1) - gammaln(x + 1) - gammaln(trials - x + 1)
    return choices + xlogy(x, probability) + xlog1py(trials - x, -probability)
