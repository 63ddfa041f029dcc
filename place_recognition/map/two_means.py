"""A cell of like vectors cut into two: 2-means from two members far apart, the same each time."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Flags = NDArray[np.bool_]

ROUNDS = 6  # more move hardly a member


@njit(cache=True)
def second_side(members: Floats, least: int) -> Flags:
    """Which of the members (N, D) are on the second side of 2-means, neither side having fewer than the least."""
    first, second = _far_apart(members)
    moved = np.empty(len(members), np.bool_)
    for _ in range(ROUNDS):
        side = _distances(members, first) - _distances(members, second)
        nearer = np.count_nonzero(side <= 0)
        border = min(max(nearer, least), len(members) - least)
        for k in range(len(members)):
            moved[k] = _rank(side, k) >= border
        first, second = _mean_of(members, ~moved), _mean_of(members, moved)
    return moved


@njit(cache=True)
def _distances(members: Floats, centre: Floats) -> Floats:
    """Squared Euclidean distance (N,) of members (N, D) from a centre (D,).

    Not by a BLAS, whose bits depend on its threads.
    """
    distances = np.zeros(len(members), np.float32)
    for k in range(len(members)):
        for i in range(len(centre)):
            difference = members[k, i] - centre[i]
            distances[k] += difference * difference
    return distances


@njit(cache=True)
def _rank(values: Floats, index: int) -> int:
    """How many values (N,) come before one in order; of equal ones the first comes first."""
    before, value = 0, values[index]
    for k in range(len(values)):
        before += values[k] < value or (values[k] == value and k < index)
    return before


@njit(cache=True)
def _far_apart(members: Floats) -> tuple[Floats, Floats]:
    """The member farthest from the mean and the one farthest from that."""
    mean = _mean_of(members, np.ones(len(members), np.bool_))
    first = members[_distances(members, mean).argmax()]
    return first, members[_distances(members, first).argmax()]


@njit(cache=True)
def _mean_of(members: Floats, chosen: Flags) -> Floats:
    total = np.zeros(members.shape[1], np.float32)
    for k in range(len(members)):
        if chosen[k]:
            total += members[k]
    return total / np.float32(np.count_nonzero(chosen))
