"""Descriptors of two images paired off: each the other's nearest, and clearly so."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]


def mutual_matches(first: Floats, second: Floats, ratio: float = 0.8) -> NDArray[np.intp]:
    """Pairs (K, 2) of rows of first (N, D) and second (M, D) that are each other's nearest neighbours.

    Args:
        first, second: descriptors of unit length.
        ratio: the nearest must be closer than ratio times the second nearest in second (Lowe, IJCV 2004, section 7.1);
            1 keeps all mutual pairs.

    Returns:
        Indices into first and second, increasing in first; none where an image has no descriptors.
    """
    if len(first) == 0 or len(second) == 0:
        return np.empty((0, 2), np.intp)
    similarity = first @ second.T
    rows = np.arange(len(first))
    nearest = similarity.argmax(axis=1)
    mutual = similarity.argmax(axis=0)[nearest] == rows
    best = similarity[rows, nearest]
    similarity[rows, nearest] = -np.inf
    runner_up = similarity.max(axis=1)
    # of unit vectors: distance^2 = 2 - 2 similarity
    clear = np.maximum(1 - best, 0) <= ratio**2 * (1 - runner_up)
    keep = np.flatnonzero(mutual & clear)
    return np.stack([keep, nearest[keep]], axis=1)
