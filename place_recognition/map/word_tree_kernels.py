"""Searching and growing a balanced tree of cells of like vectors: the compiled part of `WordTree`.

A node holds up to CAPACITY entries: words in a leaf, nodes above. The vectors of a node's entries are the columns of a
small matrix of bytes, which one compiled product compares with a query. Closeness of query q and vector w is
q.w - |w|^2 / 2, greatest where the Euclidean distance is least; of unit vectors in steps of 1 / 127 it needs 16 bits.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from place_recognition.belief.quantised_matching import add_integer_products, largest
from place_recognition.map.two_means import second_side

Bytes = NDArray[np.int8]
Shorts = NDArray[np.int16]
Integers = NDArray[np.int32]
Indices = NDArray[np.int64]

CAPACITY = 256
LEAST_FILL = CAPACITY // 4  # entries of each half when a node is split: keeps the tree from growing deep
DEEPEST = 16  # levels; at least LEAST_FILL^15 words
REFINED = 8  # words nearest by bytes among which the nearest is sought: by bytes alone 8 in 100 go to a near tie
FINE = 256  # steps of two bytes in one of one byte
FAR = np.int16(-32767)


class Nodes(NamedTuple):
    """All nodes, in pools that the class enlarges.

    Attributes:
        vectors: (P, D, CAPACITY) vectors of the entries, as columns.
        half_norms: (P, CAPACITY) half their squared length.
        entries: (P, CAPACITY) words or nodes.
        counts: (P,) entries in use.
        shape: (3,) nodes in use, the root, levels.
    """

    vectors: Bytes
    half_norms: Shorts
    entries: Integers
    counts: Integers
    shape: Indices


@njit(cache=True)
def insert_words(nodes: Nodes, words: Shorts, first: int) -> None:
    """Add words (K, D) of two bytes a number, counted from first on; the pools must have room."""
    path, slots = np.empty(DEEPEST, np.int64), np.empty(DEEPEST, np.int64)
    for k in range(len(words)):
        word = as_bytes(words[k])
        leaf = _descend(nodes, word, path, slots)
        _append(nodes, leaf, word, first + k)
        _split_overfull(nodes, path, slots)


@njit(cache=True)
def search_words(nodes: Nodes, words: Shorts, queries: Shorts, beam: int) -> Indices:
    """The nearest word (N,) of each query (N, D) among those in the leaves that the beam reaches.

    Args:
        nodes: the tree, of bytes.
        words: (K, D) all words in two bytes a number, for the choice among those nearest by bytes.
        queries: like the words.
        beam: nodes followed on each level.
    """
    found = np.empty(len(queries), np.int64)
    for k in range(len(queries)):
        near = _near_words(nodes, as_bytes(queries[k]), beam)
        found[k] = _nearest_of(near, words, queries[k])
    return found


@njit(cache=True)
def as_bytes(fine: Shorts) -> Bytes:
    """The upper of two bytes of each number (D,), rounded."""
    upper = np.empty(len(fine), np.int8)
    for k in range(len(fine)):
        upper[k] = (np.int32(fine[k]) + FINE // 2) // FINE
    return upper


@njit(cache=True)
def _nearest_of(near: Indices, words: Shorts, query: Shorts) -> int:
    nearest, least = 0, np.inf
    for word in near:
        distance = 0.0
        for k in range(len(query)):
            difference = np.float64(words[word, k]) - np.float64(query[k])
            distance += difference * difference
        if distance < least or (distance == least and word < nearest):
            nearest, least = word, distance
    return nearest


@njit(cache=True)
def _near_words(nodes: Nodes, query: Bytes, beam: int) -> Indices:
    """Level by level the entries of the nearest nodes, of which again the nearest; of the leaves' entries a few."""
    reached, closeness = np.array([nodes.shape[1]]), np.zeros(1, np.int16)
    for level in range(nodes.shape[2]):
        wanted = beam if level + 2 == nodes.shape[2] else (beam + 1) // 2
        wanted = REFINED if level + 1 == nodes.shape[2] else wanted
        below, closeness = np.empty(wanted, np.int64), np.full(wanted, FAR)
        count = _nearest_entries(nodes, query, reached, below, closeness)
        reached = below[:count]
    return reached


@njit(cache=True)
def _nearest_entries(nodes: Nodes, query: Bytes, reached: Indices, entries: Indices, closeness: Shorts) -> int:
    """Fill in the nearest entries of the nodes reached with how close they are, nearest first; returns how many."""
    similarity = np.empty(CAPACITY, np.int16)
    filled, last = 0, len(entries) - 1
    for node in reached:
        count = nodes.counts[node]
        compare(nodes, node, query, similarity)
        if largest(similarity[:count]) <= closeness[last]:
            continue
        for k in range(count):
            if similarity[k] > closeness[last]:
                _insert(entries, closeness, nodes.entries[node, k], similarity[k])
                filled = min(filled + 1, len(entries))
    return filled


@njit(cache=True)
def _insert(entries: Indices, closeness: Shorts, entry: int, value: int) -> None:
    """Put an entry in its place, nearest first, and drop the last."""
    place = len(entries) - 1
    while place > 0 and closeness[place - 1] < value:
        entries[place], closeness[place] = entries[place - 1], closeness[place - 1]
        place -= 1
    entries[place], closeness[place] = entry, value


@njit(cache=True)
def compare(nodes: Nodes, node: int, query: Bytes, out: Shorts) -> None:
    """Closeness (CAPACITY,) of a query (D,) and the entries of a node; only its count is meaningful."""
    width = min((nodes.counts[node] + 15) // 16 * 16, CAPACITY)
    for k in range(width):
        out[k] = -nodes.half_norms[node, k]
    add_integer_products(query, nodes.vectors[node, :, :width], out[:width])


@njit(cache=True)
def _descend(nodes: Nodes, word: Bytes, path: Indices, slots: Indices) -> int:
    """The leaf where a word belongs, with the path to it: nodes from the root and the slot taken in each."""
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
    slot = nodes.counts[node]
    nodes.counts[node] = slot + 1
    nodes.entries[node, slot] = entry
    _set_vector(nodes, node, slot, vector)


@njit(cache=True)
def _set_vector(nodes: Nodes, node: int, slot: int, vector: Bytes) -> None:
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
    root = nodes.shape[0]
    nodes.shape[0], nodes.shape[1], nodes.shape[2] = root + 1, root, nodes.shape[2] + 1
    _append(nodes, root, _mean(nodes, first), first)
    _append(nodes, root, _mean(nodes, second), second)


@njit(cache=True)
def _mean(nodes: Nodes, node: int) -> Bytes:
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
    """Move the entries on one side of a node to a new one, which is returned."""
    twin = nodes.shape[0]
    nodes.shape[0] = twin + 1
    members = np.ascontiguousarray(nodes.vectors[node].T)
    entries = nodes.entries[node].copy()
    moved = second_side(members.astype(np.float32), LEAST_FILL)
    nodes.counts[node] = nodes.counts[twin] = 0
    for k in range(CAPACITY):
        _append(nodes, twin if moved[k] else node, members[k], entries[k])
    return twin
