"""Votes normalised by a rule of thumb, which section 4.2.3.3 of the chapter compares with the binomial density.

For the chapter; no paradigm uses it.
"""

import numpy as np
from numpy.typing import NDArray

Indices = NDArray[np.int64]


def normalize_votes(votes: Indices, words: Indices, descriptors: int) -> NDArray[np.float64]:
    """Divide votes by the geometric mean of the number of words and the number of voting descriptors.

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
