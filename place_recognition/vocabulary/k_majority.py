"""Hierarchical k-majority: a tree of clusters of binary descriptors, whose leaves are the words.

k-majority: Grana, Borghesani, Manfredi, Cucchiara, 'A fast approach for integrating ORB descriptors in the bag of words
model', SPIE 8667, 2013; the tree: Galvez-Lopez, Tardos, TRO 28(5) 2012, section III. Distances are Hamming's, a centre
is the majority vote of its members bit by bit, and a tie is 0 as there.
"""

import heapq

import numpy as np
from numpy.typing import NDArray

Bits = NDArray[np.bool_]
Indices = NDArray[np.int64]

ROUNDS = 15  # of assignment and vote; most clusters are stable after ten
ROWS = 65536  # descriptors compared at a time: as float32 they take four times the memory of their bytes


def k_majority(bits: Bits, words: int, branching: int, rng: np.random.Generator) -> Bits:
    """Cluster binary descriptors into words.

    The tree grows where most descriptors share a leaf, not level by level: so it has any number of leaves, and the
    finer ones in dense regions.

    Args:
        bits: (N, D) descriptors.
        words: number of words.
        branching: maximum number of children of a node.
        rng: generator for the choice of first centres (k-means++).

    Returns:
        (W, D) words; W is less than `words` where the descriptors do not differ enough.
    """
    order = 0
    leaves: list[tuple[int, int, Indices]] = [(-len(bits), order, np.arange(len(bits)))]
    settled: list[Indices] = []
    while leaves and len(leaves) + len(settled) < words:
        _, _, members = heapq.heappop(leaves)
        room = words - len(leaves) - len(settled)
        children = _split(bits[members], min(branching, room), rng)
        if len(children) == 1:
            settled.append(members)
            continue
        for child in children:
            order += 1
            heapq.heappush(leaves, (-len(child), order, members[child]))
    groups = settled + [members for _, _, members in sorted(leaves, key=lambda leaf: leaf[1])]
    return np.array([_vote(bits[members]) for members in groups])


def _split(bits: Bits, clusters: int, rng: np.random.Generator) -> list[Indices]:
    """Return the rows of each cluster, none empty; one cluster where all descriptors are the same."""
    centres = _first_centres(bits, clusters, rng)
    nearest = np.full(len(bits), -1)
    for _ in range(ROUNDS):
        before, nearest = nearest, _nearest(bits, centres)
        if np.array_equal(before, nearest):
            break
        centres = np.array([_vote(bits[nearest == k]) for k in np.unique(nearest)])
    return [np.flatnonzero(nearest == k) for k in np.unique(nearest)]


def _first_centres(bits: Bits, clusters: int, rng: np.random.Generator) -> Bits:
    # k-means++: each next centre is drawn with a probability that grows with its squared distance from those so far.
    centres = [bits[rng.integers(len(bits))]]
    far = _hamming(bits, centres[0])
    while len(centres) < clusters and far.any():
        chance = np.cumsum(far.astype(np.float64) ** 2)
        centres.append(bits[np.searchsorted(chance, rng.random() * chance[-1], side="right")])
        far = np.minimum(far, _hamming(bits, centres[-1]))
    return np.array(centres)


def _vote(bits: Bits) -> Bits:
    return bits.sum(axis=0) * 2 > len(bits)


def _hamming(bits: Bits, centre: Bits) -> Indices:
    return np.count_nonzero(bits != centre, axis=1)


def _nearest(bits: Bits, centres: Bits) -> Indices:
    """Find the centre (N,) at the least Hamming distance."""
    # Agreeing bits are counted by a matrix product; its whole numbers are exact in any order of summation.
    signs = centres.astype(np.float32).T * 2 - 1
    zeros = np.count_nonzero(~centres, axis=1)
    blocks = (bits[begin : begin + ROWS].astype(np.float32) for begin in range(0, len(bits), ROWS))
    return np.concatenate([(block @ signs + zeros).argmax(axis=1) for block in blocks])
