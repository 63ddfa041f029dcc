"""Votes of an image's descriptors for the locations of a map of words, and how unlikely they are by chance.

Tsintotas, Bampis, Gasteratos, RA-L 4(2) 2019, section III-C, equations 4 to 6.
"""

import math
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

    def leaders(self, count: int, apart: int, log_threshold: float) -> list[int]:
        """Up to `count` locations, at least `apart` from one another, that most likely are the place; best first.

        Only locations with more votes than expected count. Those less likely than the threshold come first, the most
        votes before fewer, then the others, the less likely before the likelier.
        """
        above = np.flatnonzero(self.votes > self.expected)
        likely = self.log_density[above] >= log_threshold
        order = above[np.lexsort((self.log_density[above], np.where(likely, 0, -self.votes[above]), likely))]
        leaders: list[int] = []
        for location in self.locations[order].tolist():
            if len(leaders) < count and all(abs(location - other) >= apart for other in leaders):
                leaders.append(location)
        return leaders

    def improbability(self, location: int, reach: int) -> float:
        """-log10 of the probability of the votes of a location, or of one within reach that are less likely."""
        first, end = np.searchsorted(self.locations, [location - reach, location + reach + 1])
        surprising = self.votes[first:end] > self.expected[first:end]
        return float(max(-self.log_density[first:end][surprising].min(initial=0.0), 0.0)) / math.log(10)


def count_votes(hit: Indices, words: WordMap) -> Ballot:
    """Let each word hit, given as distinct indices (N,), vote once for each location where it was seen.

    Each location is hit with probability p = its words / all words (eq. 5); its votes are binomial (eq. 4). In the
    paper a word votes as often as it is hit. But what makes many descriptors of an image hit one word, a repeated
    window or the sky, is no chance of its own each time, and the binomial test would take them for independent.
    """
    locations, votes = np.unique(covered(words.spans(hit)), return_counts=True)
    share = words.words_at(locations) / max(words.active_count, 1)
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
