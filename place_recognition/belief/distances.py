"""Distances and similarities of descriptor vectors: equations 4.1 to 4.3 and 4.6 of the chapter.

All functions of two vectors take (..., n) that broadcast against each other: one (n,) against many (K, n) gives (K,).
The paradigms of sequences use `l2_score_of_cosine` and `scaled_l2_score_of_cosine`. The functions of two vectors are
for the chapter; no paradigm uses them.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def sum_of_absolute_differences(first: ArrayLike, second: ArrayLike) -> Array:
    """Return the mean absolute difference (...) of images as vectors of grey levels (..., n) (eq. 4.1)."""
    a, b = _pair(first, second)
    return np.abs(a - b).mean(axis=-1)


def euclidean_distance(first: ArrayLike, second: ArrayLike) -> Array:
    """Return the length (...) of the difference of vectors (..., n) (eq. 4.2)."""
    a, b = _pair(first, second)
    return np.linalg.norm(a - b, axis=-1)


def cosine_similarity(first: ArrayLike, second: ArrayLike) -> Array:
    """Return the cosine (...) of the angle between vectors (..., n); 0 where one of them is zero."""
    a, b = _pair(first, second)
    lengths = np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
    products = np.sum(a * b, axis=-1)
    return np.divide(products, lengths, out=np.zeros_like(products), where=lengths > 0)


def cosine_distance(first: ArrayLike, second: ArrayLike) -> Array:
    """Return 1 - cosine (...) of vectors (..., n) (eq. 4.3): 0 for equal directions, 1 for a right angle or a zero."""
    return 1.0 - cosine_similarity(first, second)


def l2_score(first: ArrayLike, second: ArrayLike) -> Array:
    """Return the L2 score (...) of vectors (..., n) as printed in equation 4.6; see `l2_score_of_cosine`."""
    return l2_score_of_cosine(cosine_similarity(first, second))


def scaled_l2_score(first: ArrayLike, second: ArrayLike) -> Array:
    """Return the L2 score (...) of vectors (..., n) in [0, 1]; see `scaled_l2_score_of_cosine`."""
    return scaled_l2_score_of_cosine(cosine_similarity(first, second))


def l2_score_of_cosine(cosine: ArrayLike) -> Array:
    """Return equation 4.6 as printed, 1 - |u - v| / 2 for unit vectors u and v, from their cosine.

    For word vectors, which have no negative components, it lies in [0.29, 1]. The published filters and thresholds
    presuppose 0 for unrelated images, so it is not the default.
    """
    return 1.0 - 0.5 * np.sqrt(np.maximum(2.0 - 2.0 * np.asarray(cosine, np.float64), 0.0))


def scaled_l2_score_of_cosine(cosine: ArrayLike) -> Array:
    """Return the L2 score stretched to [0, 1] for vectors without negative components, as DBoW2 does.

    It is 1 - sqrt(1 - cosine).
    """
    return 1.0 - np.sqrt(np.maximum(1.0 - np.asarray(cosine, np.float64), 0.0))


def _pair(first: ArrayLike, second: ArrayLike) -> tuple[Array, Array]:
    a, b = np.asarray(first, np.float64), np.asarray(second, np.float64)
    if a.ndim == 0 or b.ndim == 0 or a.shape[-1] != b.shape[-1] or a.shape[-1] == 0:
        raise ValueError(f"expected vectors of the same length, got shapes {a.shape} and {b.shape}")
    return a, b
