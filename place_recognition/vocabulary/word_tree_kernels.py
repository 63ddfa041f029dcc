"""Compiled search and insertion of `WordTree`, a balanced tree of cells of like vectors.

A node holds up to CAPACITY entries: words in a leaf, nodes above. The vectors of a node's entries are the columns of a
small matrix of bytes, which one compiled product compares with a query. Closeness of query q and vector w is
q.w - |w|^2 / 2, greatest where the Euclidean distance is least; of unit vectors in steps of 1 / 127 it needs 16 bits.
A full node is split by 2-means from two members far apart, which needs no random number.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from place_recognition.image_processing.matching import add_integer_products, largest

Floats = NDArray[np.float32]
Flags = NDArray[np.bool_]
Bytes = NDArray[np.int8]
Shorts = NDArray[np.int16]
Integers = NDArray[np.int32]
Indices = NDArray[np.int64]

CAPACITY = 256  # entries of a node
MIN_FILL = CAPACITY // 4  # entries of each half of a node that is split: keeps the tree from growing deep
MAX_LEVELS = 16  # room for MIN_FILL^15 words at least
REFINED = 8  # candidates compared by two bytes: by one byte alone 8 in 100 queries get a near tie instead
FINE = 256  # steps of a two-byte number in a step of a one-byte number
FAR = np.int16(-32767)  # less than any closeness of unit vectors
ROUNDS = 6  # of assignment and mean when a node is split; further ones move hardly a member


class Nodes(NamedTuple):
    """All nodes of a tree, in pools of P nodes that `WordTree` enlarges.

    Attributes:
        vectors: (P, D, CAPACITY) int8 vectors of the entries, as columns: words, or means of the nodes below.
        half_norms: (P, CAPACITY) int16 half the squared length of each vector.
        entries: (P, CAPACITY) int32 numbers of words in a leaf, of nodes above.
        counts: (P,) int32 number of entries in use.
        shape: (3,) number of nodes in use, number of the root, number of levels.
    """

    vectors: Bytes
    half_norms: Shorts
    entries: Integers
    counts: Integers
    shape: Indices


@njit(cache=True, nogil=True)
def insert_words(nodes: Nodes, words: Shorts, first: int) -> None:
    """Insert words (K, D) of two bytes a number, the first of which has number `first`; the pools must have room."""
    path, slots = np.empty(MAX_LEVELS, np.int64), np.empty(MAX_LEVELS, np.int64)
    for k in range(len(words)):
        word = as_bytes(words[k])
        leaf = _descend(nodes, word, path, slots)
        _append(nodes, leaf, word, first + k)
        _split_overfull(nodes, path, slots)


@njit(cache=True, nogil=True)
def search_words(nodes: Nodes, words: Shorts, queries: Shorts, beam: int) -> Indices:
    """Find the nearest word (N,) of each query (N, D) among the leaves that the beam reaches.

    Args:
        nodes: tree of one byte a number.
        words: (K, D) all words in two bytes a number, for the choice among the nearest by one byte.
        queries: (N, D) in two bytes a number.
        beam: number of nodes followed on the last level but one.
    """
    found = np.empty(len(queries), np.int64)
    for k in range(len(queries)):
        near = _near_words(nodes, as_bytes(queries[k]), beam)
        found[k] = _nearest_of(near, words, queries[k])
    return found


@njit(cache=True)
def as_bytes(fine: Shorts) -> Bytes:
    """Round numbers (D,) of two bytes to the upper byte."""
    upper = np.empty(len(fine), np.int8)
    for k in range(len(fine)):
        upper[k] = (np.int32(fine[k]) + FINE // 2) // FINE
    return upper


@njit(cache=True)
def _nearest_of(near: Indices, words: Shorts, query: Shorts) -> int:
    """Choose the nearest of a few words by two bytes a number; the first of equally near ones."""
    nearest, smallest = 0, np.inf
    for word in near:
        distance = 0.0
        for k in range(len(query)):
            difference = np.float64(words[word, k]) - np.float64(query[k])
            distance += difference * difference
        if distance < smallest or (distance == smallest and word < nearest):
            nearest, smallest = word, distance
    return nearest


@njit(cache=True)
def _near_words(nodes: Nodes, query: Bytes, beam: int) -> Indices:
    """Search by a beam: keep the nearest entries of the nodes reached, level by level, and a few words at the end."""
    reached, closeness = np.array([nodes.shape[1]]), np.zeros(1, np.int16)
    for level in range(nodes.shape[2]):
        # Upper levels have fewer nodes, of which half the beam is a larger share.
        wanted = beam if level + 2 == nodes.shape[2] else (beam + 1) // 2
        wanted = REFINED if level + 1 == nodes.shape[2] else wanted
        below, closeness = np.empty(wanted, np.int64), np.full(wanted, FAR)
        count = _nearest_entries(nodes, query, reached, below, closeness)
        reached = below[:count]
    return reached


@njit(cache=True)
def _nearest_entries(nodes: Nodes, query: Bytes, reached: Indices, entries: Indices, closeness: Shorts) -> int:
    """Write the nearest entries of the nodes reached with their closeness, nearest first; return their number."""
    similarity = np.empty(CAPACITY, np.int16)
    filled, last = 0, len(entries) - 1
    for node in reached:
        count = nodes.counts[node]
        compare(nodes, node, query, similarity)
        # One SIMD maximum dismisses a node without a nearer entry, which saves the walk over its entries.
        if largest(similarity[:count]) <= closeness[last]:
            continue
        for k in range(count):
            if similarity[k] > closeness[last]:
                _insert(entries, closeness, nodes.entries[node, k], similarity[k])
                filled = min(filled + 1, len(entries))
    return filled


@njit(cache=True)
def _insert(entries: Indices, closeness: Shorts, entry: int, value: int) -> None:
    """Insert an entry in order, nearest first, and drop the last."""
    place = len(entries) - 1
    while place > 0 and closeness[place - 1] < value:
        entries[place], closeness[place] = entries[place - 1], closeness[place - 1]
        place -= 1
    entries[place], closeness[place] = entry, value


@njit(cache=True)
def compare(nodes: Nodes, node: int, query: Bytes, out: Shorts) -> None:
    """Write the closeness (CAPACITY,) of a query (D,) and the entries of a node; values past its count mean nothing."""
    # Whole SIMD registers of 16 numbers: the loop needs no remainder, and the extra columns are never looked at.
    width = min((nodes.counts[node] + 15) // 16 * 16, CAPACITY)
    for k in range(width):
        out[k] = -nodes.half_norms[node, k]
    add_integer_products(query, nodes.vectors[node, :, :width], out[:width])


@njit(cache=True)
def _descend(nodes: Nodes, word: Bytes, path: Indices, slots: Indices) -> int:
    """Find the leaf of a word by the nearest node of each level.

    path and slots receive the nodes from the root on, and the entry taken in each.
    """
    similarity = np.empty(CAPACITY, np.int16)
    path[0] = nodes.shape[1]
    for level in range(nodes.shape[2] - 1):
        node = int(path[level])
        compare(nodes, node, word, similarity)
        slots[level] = similarity[: nodes.counts[node]].argmax()
        path[level + 1] = nodes.entries[node, slots[level]]
    return int(path[nodes.shape[2] - 1])


@njit(cache=True)
def _append(nodes: Nodes, node: int, vector: Bytes, entry: int) -> None:
    """Add an entry to a node that has room."""
    slot = nodes.counts[node]
    nodes.counts[node] = slot + 1
    nodes.entries[node, slot] = entry
    _set_vector(nodes, node, slot, vector)


@njit(cache=True)
def _set_vector(nodes: Nodes, node: int, slot: int, vector: Bytes) -> None:
    """Write the vector of an entry, and half its squared length."""
    square = np.int64(0)
    for k in range(len(vector)):
        nodes.vectors[node, k, slot] = vector[k]
        square += np.int64(vector[k]) * np.int64(vector[k])
    nodes.half_norms[node, slot] = square // 2


@njit(cache=True)
def _split_overfull(nodes: Nodes, path: Indices, slots: Indices) -> None:
    """Split full nodes from the leaf of a path upwards, so that each has room for one more entry."""
    for level in range(nodes.shape[2] - 1, -1, -1):
        node = path[level]
        if nodes.counts[node] < CAPACITY:
            return
        twin = _split(nodes, node)
        if level == 0:
            _grow_root(nodes, node, twin)
        else:
            _set_vector(nodes, path[level - 1], slots[level - 1], _mean(nodes, node))
            _append(nodes, path[level - 1], _mean(nodes, twin), twin)


@njit(cache=True)
def _grow_root(nodes: Nodes, first: int, second: int) -> None:
    """Put a new root above the halves of the old one; only here does the tree get a level."""
    root = nodes.shape[0]
    nodes.shape[0], nodes.shape[1], nodes.shape[2] = root + 1, root, nodes.shape[2] + 1
    _append(nodes, root, _mean(nodes, first), first)
    _append(nodes, root, _mean(nodes, second), second)


@njit(cache=True)
def _mean(nodes: Nodes, node: int) -> Bytes:
    """Average the vectors of a node, rounded; whole numbers, so that no order of summing changes it."""
    count, dimension = nodes.counts[node], nodes.vectors.shape[1]
    mean = np.empty(dimension, np.int8)
    for k in range(dimension):
        total = 0
        for slot in range(count):
            total += nodes.vectors[node, k, slot]
        mean[k] = (2 * total + count) // (2 * count)
    return mean


@njit(cache=True)
def _split(nodes: Nodes, node: int) -> int:
    """Move the entries of one half of a node to a new node, and return that."""
    twin = nodes.shape[0]
    nodes.shape[0] = twin + 1
    members = np.ascontiguousarray(nodes.vectors[node].T)
    entries = nodes.entries[node].copy()
    moved = split_in_two(members.astype(np.float32), MIN_FILL)
    nodes.counts[node] = nodes.counts[twin] = 0
    for k in range(CAPACITY):
        _append(nodes, twin if moved[k] else node, members[k], entries[k])
    return twin


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
def _distances(members: Floats, center: Floats) -> Floats:
    """Compute the squared Euclidean distance (N,) of members (N, D) from a centre (D,)."""
    # Not by a BLAS, whose bits depend on its number of threads.
    distances = np.zeros(len(members), np.float32)
    for k in range(len(members)):
        for i in range(len(center)):
            difference = members[k, i] - center[i]
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
