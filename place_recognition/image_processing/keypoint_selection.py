"""Selection of the strongest features of an image, spread evenly so that no corner of it dominates."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

Indices = NDArray[np.int64]


@dataclass(frozen=True)
class SpreadConfig:
    """Distribution of the features over an image.

    Attributes:
        bucket_px: side of the squares into which the image is divided.
        max_crowding_ratio: maximum number of features of a square, in multiples of its even share, before the other
            squares have had theirs.
    """

    bucket_px: int = 80
    max_crowding_ratio: float = 4.0


def select_strongest(
    pixels: NDArray[np.generic],
    responses: NDArray[np.float32],
    shape: tuple[int, int],
    count: int,
    config: SpreadConfig,
) -> Indices:
    """Select the strongest features, evenly spread.

    Features beyond the share of their square are taken only where those of all other squares are too few.

    Args:
        pixels: (N, 2) positions, x right and y down.
        responses: (N,) strengths.
        shape: (H, W) of the image.
        count: maximum number of features.
        config: size of the squares and their share.

    Returns:
        Indices of the features, strongest first; the first of equal ones.
    """
    order = np.argsort(-responses, kind="stable")
    if len(order) <= count:
        return order
    squares = (pixels[order] // config.bucket_px).astype(np.int64)
    rows, columns = (side // config.bucket_px + 1 for side in shape)
    rank = _rank_in_square(squares[:, 1] * columns + squares[:, 0], rows * columns)
    even_share = count / np.prod(np.ceil(np.array(shape) / config.bucket_px))
    crowded = rank >= config.max_crowding_ratio * even_share
    return order[np.sort(np.argsort(crowded, kind="stable")[:count])]


@njit(cache=True, nogil=True)
def _rank_in_square(squares: Indices, count: int) -> Indices:
    """Count for each of squares (N,), numbers below count, the equal ones before it."""
    seen, rank = np.zeros(count, np.int64), np.empty(len(squares), np.int64)
    for k in range(len(squares)):
        rank[k] = seen[squares[k]]
        seen[squares[k]] += 1
    return rank
