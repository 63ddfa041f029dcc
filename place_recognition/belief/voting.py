"""Votes of an image's visual words for the locations or places of a map, and their probability by chance.

* Locations (tracked words): Tsintotas, Bampis, Gasteratos, RA-L 4(2) 2019, section III-C, equations 4 to 6.
* Places (hierarchical places): Tsintotas, Bampis, Gasteratos, 'Assigning Visual Words to Places for Loop Closure
  Detection', ICRA 2018, equations 5 to 10.

Derivation of the binomial model: docs/math.md.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, xlog1py, xlogy

from place_recognition.map.place_map import PlaceMap
from place_recognition.vocabulary.word_tracking import WordMap

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Votes:
    """Votes of one image for locations; only locations with votes are listed.

    Attributes:
        locations: (V,) int64, increasing.
        votes: (V,) int64, number of votes of each location, at least 1.
        expected: (V,) number of votes expected if words were hit at random.
        log_density: (V,) natural logarithm of the binomial probability of exactly these votes.
    """

    locations: Indices
    votes: Indices
    expected: Array
    log_density: Array


def count_votes(hit: Indices, words: WordMap, distinct: bool = True) -> Votes:
    """Count the votes of an image: each word that it hits votes for each location where the word was seen.

    A location is hit with probability p = its words / all words (eq. 5), so its votes are binomial (eq. 4).

    Args:
        hit: (N,) indices of the words hit, one for each descriptor.
        words: map of all words.
        distinct: whether a word votes once, however often it is hit. In the paper it votes as often; but many
            descriptors of an image hit one word for one reason, a repeated window or the sky, and the binomial test
            would take them for independent trials.
    """
    hit = np.unique(hit) if distinct else hit
    locations, votes = np.unique(expand_spans(words.spans(hit)), return_counts=True)
    share = words.words_at(locations) / max(words.active_count, 1)
    return Votes(locations, votes, len(hit) * share, log_binomial(votes, len(hit), share))


@dataclass(frozen=True)
class PlaceVotes:
    """Votes of one image for places; only places with more votes than expected, the least likely by chance first.

    Attributes:
        places: (P,) int64 indices of the places.
        votes: (P,) int64, number of words of each place that were hit.
        log_density: (P,) natural logarithm of the binomial probability of exactly these votes.
    """

    places: Indices
    votes: Indices
    log_density: NDArray[np.float64]

    def neg_log10_probability(self, place: int) -> float:
        """Return -log10 of the probability of the votes of a place; 0 if it has no more votes than expected."""
        found = np.flatnonzero(self.places == place)
        return -float(self.log_density[found[0]]) / math.log(10) if len(found) else 0.0


def vote_for_places(hit: Indices, places: PlaceMap, count: int, distinct: bool = True) -> PlaceVotes:
    """Count the votes of an image: each word that it hits votes for its place.

    A place is hit with probability p = its words / all words (equations 5 to 8). Places with fewer votes than expected
    are dropped before the least likely one is sought, because too few votes are unlikely too.

    Args:
        hit: (N,) indices of the words hit, repeated where several descriptors hit one word.
        places: map of all places.
        count: number of places, from the first one on, that may be voted for.
        distinct: whether a word votes once, however often it is hit (`count_votes`).
    """
    total = places.count_words_of_first(count)
    words = hit[hit < total]
    words = np.unique(words) if distinct else words
    voted, votes = np.unique(places.places_of(words), return_counts=True)
    share = places.word_counts(voted) / max(total, 1)
    above = votes > len(words) * share
    density = log_binomial(votes[above], len(words), share[above])
    order = np.argsort(density, kind="stable")
    return PlaceVotes(voted[above][order], votes[above][order], density[order])


def expand_spans(spans: NDArray[np.int32] | Indices) -> Indices:
    """Return all locations of spans (K, 2), both ends included, one span after the other."""
    lengths = spans[:, 1] - spans[:, 0] + 1
    begins = np.cumsum(lengths) - lengths
    return np.arange(lengths.sum(), dtype=np.int64) + np.repeat(spans[:, 0] - begins, lengths)


def log_binomial(successes: Indices, trials: int, probability: Array) -> Array:
    """Return the natural logarithm of C(n, x) p^x (1 - p)^(n - x), elementwise; -inf for an impossible number."""
    x = np.asarray(successes, dtype=np.float64)
    choices = gammaln(trials + 1) - gammaln(x + 1) - gammaln(trials - x + 1)
    return choices + xlogy(x, probability) + xlog1py(trials - x, -probability)
