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

    def top_locations(self, max_count: int, min_separation: int, log_threshold: float) -> list[int]:
        """Return up to `max_count` locations that most likely show the place, best first.

        Only locations with more votes than expected count. Those whose density is below the threshold come first,
        sorted by votes; the others follow, sorted by density.

        Args:
            max_count: largest number of locations.
            min_separation: smallest distance between any two of them, in locations.
            log_threshold: natural logarithm of the density below which votes are significant.
        """
        above = np.flatnonzero(self.votes > self.expected)
        likely = self.log_density[above] >= log_threshold
        order = above[np.lexsort((self.log_density[above], np.where(likely, 0, -self.votes[above]), likely))]
        top: list[int] = []
        for location in self.locations[order].tolist():
            if len(top) < max_count and all(abs(location - other) >= min_separation for other in top):
                top.append(location)
        return top

    def neg_log10_probability(self, location: int, radius: int) -> float:
        """Return -log10 of the smallest density of the votes within `radius` locations; 0 if none exceeds chance."""
        first, end = np.searchsorted(self.locations, [location - radius, location + radius + 1])
        is_above = self.votes[first:end] > self.expected[first:end]
        return float(max(-self.log_density[first:end][is_above].min(initial=0.0), 0.0)) / math.log(10)


def count_votes(hit: Indices, words: WordMap) -> Votes:
    """Count the votes of an image: each word that it hits votes once for each location where the word was seen.

    A location is hit with probability p = its words / all words (eq. 5), so its votes are binomial (eq. 4). In the
    paper a word votes as often as it is hit. But many descriptors of an image hit one word for one reason, a repeated
    window or the sky, and the binomial test would take them for independent trials.

    Args:
        hit: (N,) distinct indices of the words hit.
        words: map of all words.
    """
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


def vote_for_places(hit: Indices, places: PlaceMap, count: int) -> PlaceVotes:
    """Count the votes of an image: each distinct word that it hits votes once for its place.

    A place is hit with probability p = its words / all words (equations 5 to 8). Places with fewer votes than expected
    are dropped before the least likely one is sought, because too few votes are unlikely too. In the paper a word votes
    as often as it is hit; why not here: docs/decisions/hierarchical_places.md.

    Args:
        hit: (N,) indices of the words hit, repeated where several descriptors hit one word.
        places: map of all places.
        count: number of places, from the first one on, that may be voted for.
    """
    total = places.count_words_of_first(count)
    words = np.unique(hit[hit < total])
    voted, votes = np.unique(places.places_of(words), return_counts=True)
    share = places.word_counts(voted) / max(total, 1)
    above = votes > len(words) * share
    density = log_binomial(votes[above], len(words), share[above])
    order = np.argsort(density, kind="stable")
    return PlaceVotes(voted[above][order], votes[above][order], density[order])


def expand_spans(spans: NDArray[np.int32]) -> Indices:
    """Return all locations of spans (K, 2), both ends included, one span after the other."""
    lengths = spans[:, 1] - spans[:, 0] + 1
    begins = np.cumsum(lengths) - lengths
    return np.arange(lengths.sum(), dtype=np.int64) + np.repeat(spans[:, 0] - begins, lengths)


def log_binomial(successes: Indices, trials: int, probability: Array) -> Array:
    """Return the natural logarithm of C(n, x) p^x (1 - p)^(n - x), elementwise; -inf for an impossible number."""
    x = np.asarray(successes, dtype=np.float64)
    choices = gammaln(trials + 1) - gammaln(x + 1) - gammaln(trials - x + 1)
    return choices + xlogy(x, probability) + xlog1py(trials - x, -probability)


def normalize_votes(votes: Indices, words: Indices, descriptors: int) -> NDArray[np.float64]:
    """Divide votes by the geometric mean of the number of words and the number of voting descriptors.

    A rule of thumb, which section 4.2.3.3 of the chapter compares with the binomial density; no paradigm uses it.
    A place of many words draws many votes, and an image of many descriptors gives many: the count alone means little.
    Where each word and each descriptor votes at most once, the result is the cosine of the angle between the two sets
    (the coefficient of Ochiai), from 0 to 1. Unlike the binomial density it ignores the other places, so the value that
    indicates a revisit differs from map to map.

    Args:
        votes: (L,) number of votes of each place or location.
        words: (L,) number of words of each; a place without words draws no votes.
        descriptors: number of descriptors of the voting image.

    Returns:
        (L,) normalised votes; 0 where there are no words or descriptors.

    Raises:
        ValueError: `votes` and `words` differ in shape, or a number is negative.
    """
    votes, words = np.asarray(votes), np.asarray(words)
    if votes.shape != words.shape:
        raise ValueError(f"expected votes and words of one shape, got {votes.shape} and {words.shape}")
    if descriptors < 0 or (votes < 0).any() or (words < 0).any():
        raise ValueError("expected no negative number of votes, words or descriptors")
    possible = np.sqrt(words.astype(np.float64) * descriptors)
    return np.divide(votes, possible, out=np.zeros(votes.shape), where=possible > 0)
