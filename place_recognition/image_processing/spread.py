"""The strongest features of an image, evenly spread: what a whole image is recognised by must not sit in one corner."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

Indices = NDArray[np.int64]


@dataclass(frozen=True)
class SpreadConfig:
    """How features are spread.

    Attributes:
        bucket: side of the squares among which they are spread, pixels.
        max_crowding: a square may hold so many times its even share before the others have had theirs.
    """

    bucket_px: int = 80
    max_crowding: float = 4.0


def select_strongest(
    pixels: NDArray[np.generic],
    responses: NDArray[np.float32],
    shape: tuple[int, int],
    count: int,
    config: SpreadConfig,
) -> Indices:
    """Indices of the strongest features, strongest first, at most so many; of equal ones the first.

    No square is crowded before the others have had their share: what exceeds it is taken only where the features of
    all other squares do not make up the number.

    Args:
        pixels: (N, 2), x right and y down.
        responses: (N,), larger is stronger.
        shape: (H, W) of the image.
        count: features wanted.
        config: how they are spread.
    """
    order = np.argsort(-responses, kind="stable")
    if len(order) <= count:
        return order
    squares = (pixels[order] // config.bucket_px).astype(np.int64)
    rows, columns = (side // config.bucket_px + 1 for side in shape)
    rank = _rank_in_square(squares[:, 1] * columns + squares[:, 0], rows * columns)
    even_share = count / np.prod(np.ceil(np.array(shape) / config.bucket_px))
    crowded = rank >= config.max_crowding * even_share
    return order[np.sort(np.argsort(crowded, kind="stable")[:count])]


@njit(cache=True, nogil=True)
def _rank_in_square(squares: Indices, count: int) -> Indices:
    """How many of the squares (N,), each below count, are the same as this one and come before it."""
    seen, rank = np.zeros(count, np.int64), np.empty(len(squares), np.int64)
    for k in range(len(squares)):
        rank[k] = seen[squares[k]]
        seen[squares[k]] += 1
    return rank
