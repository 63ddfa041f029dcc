"""Votes made comparable by a rule of thumb: what section 4.2.3.3 sets the binomial density against."""

import numpy as np
from numpy.typing import NDArray

Indices = NDArray[np.int64]


def normalise_votes(votes: Indices, words: Indices, descriptors: int) -> NDArray[np.float64]:
    """Votes over the geometric mean of what could have voted and what could have been voted for.

    A place of many words draws many votes, and an image of many descriptors gives many: the count alone means little.
    Where each of two sets votes once at most this is the cosine of the angle between them (the coefficient of Ochiai),
    from 0 to 1. Unlike the binomial density it knows nothing of the other places: how much of it is a revisit differs
    from map to map.

    Args:
        votes: (L,) votes of each place or location.
        words: (L,) words of each; none draws no votes.
        descriptors: of the image that votes.

    Returns:
        (L,) normalised votes; 0 where there are no words or descriptors.

    Raises:
        ValueError: as many votes as places have words were expected, or something is negative.
    """
    votes, words = np.asarray(votes), np.asarray(words)
    if votes.shape != words.shape:
        raise ValueError(f"expected votes and words of one shape, got {votes.shape} and {words.shape}")
    if descriptors < 0 or (votes < 0).any() or (words < 0).any():
        raise ValueError("expected no negative number of votes, words or descriptors")
    possible = np.sqrt(words.astype(np.float64) * descriptors)
    return np.divide(votes, possible, out=np.zeros(votes.shape), where=possible > 0)
