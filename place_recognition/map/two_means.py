"""Compiled split of a cell of the word tree into two: 2-means from two members far apart, without any chance."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Flags = NDArray[np.bool_]

ROUNDS = 6  # of assignment and mean; further ones move hardly a member


@njit(cache=True)
def split_in_two(members: Floats, min_members: int) -> Flags:
    """Mark the members (N, D) of the second cluster of 2-means.

    Args:
        members: (N, D) float32.
        min_members: minimum number of members of either cluster.
    """
    first, second = _far_apart(members)
    moved = np.empty(len(members), np.bool_)
    for _ in range(ROUNDS):
        side = _distances(members, first) - _distances(members, second)
        nearer = np.count_nonzero(side <= 0)
        # The clusters are divided at a rank, not at 0: so neither is too small, and the tree stays balanced.
        border = min(max(nearer, min_members), len(members) - min_members)
        for k in range(len(members)):
            moved[k] = _rank(side, k) >= border
        first, second = _mean_of(members, ~moved), _mean_of(members, moved)
    return moved


@njit(cache=True)
def _distances(members: Floats, centre: Floats) -> Floats:
    """Compute the squared Euclidean distance (N,) of members (N, D) from a centre (D,)."""
    # Not by a BLAS, whose bits depend on its number of threads.
    distances = np.zeros(len(members), np.float32)
    for k in range(len(members)):
        for i in range(len(centre)):
            difference = members[k, i] - centre[i]
            distances[k] += difference * difference
    return distances


@njit(cache=True)
def _rank(values: Floats, index: int) -> int:
    """Count the values (N,) that come before one in order; the first of equal ones comes first."""
    # No branch in the loop, so that the compiler can make it SIMD.
    before, value = 0, values[index]
    for k in range(len(values)):
        before += values[k] < value or (values[k] == value and k < index)
    return before


@njit(cache=True)
def _far_apart(members: Floats) -> tuple[Floats, Floats]:
    """Find the member farthest from the mean, and the member farthest from that."""
    mean = _mean_of(members, np.ones(len(members), np.bool_))
    first = members[_distances(members, mean).argmax()]
    return first, members[_distances(members, first).argmax()]


@njit(cache=True)
def _mean_of(members: Floats, chosen: Flags) -> Floats:
    """Average the chosen members (N, D)."""
    total = np.zeros(members.shape[1], np.float32)
    for k in range(len(members)):
        if chosen[k]:
            total += members[k]
    return total / np.float32(np.count_nonzero(chosen))
