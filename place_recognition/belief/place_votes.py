"""Votes of an image's visual words for places, and their probability by chance (hierarchical places).

Tsintotas, Bampis, Gasteratos, 'Assigning Visual Words to Places for Loop Closure Detection', ICRA 2018, equations 5-10.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from place_recognition.belief.votes import log_binomial
from place_recognition.map.places import PlaceMap

Indices = NDArray[np.int64]


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
