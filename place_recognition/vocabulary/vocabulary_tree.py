"""The vocabulary tree: binary words as the leaves of a tree of clusters, found by descent from its root.

Nister, Stewenius, 'Scalable Recognition with a Vocabulary Tree', CVPR 2006; of binary descriptors: Galvez-Lopez,
Tardos, TRO 28(5) 2012, section III. They follow the nearest child alone. Here the nearest nodes of each level are
followed (greedy N-best paths: Schindler, Brown, Szeliski, 'City-Scale Location Recognition', CVPR 2007). That finds the
nearest word far more often, so that images of a place share more words (docs/decisions/published_vocabulary.md).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from place_recognition.vocabulary.vocabulary_file import REMEDY, bit_value

Bits = NDArray[np.uint64]
Bytes = NDArray[np.uint8]
Floats = NDArray[np.float32]
Indices = NDArray[np.int64]

BITS = 64  # of a number
BEAM = 16  # nodes followed on each level: finds 93 of 100 nearest words of 100,000, where the nearest alone finds 37


@dataclass(frozen=True)
class VocabularyTree:
    """Binary visual words and their weights; found by descent (a Vocabulary).

    Nodes are in order of their depth, the root first, and the children of one node lie together.

    Attributes:
        kind: kind of the features that the words are made of (FeatureExtractor.kind), for example "brief-256".
        size: number of bits of a descriptor.
        centers: (C, ceil(size / 8)) uint8 bits of each node as `numpy.packbits` packs them; those of the root are not
            used.
        children: (C,) uint8 number of children of each node; the W nodes that have none are the words.
        weights: (W,) float32 inverse document frequencies of the words.

    Raises:
        ValueError: the shapes do not agree, or the children do not make a tree.
    """

    kind: str
    size: int
    centers: Bytes
    children: Bytes
    weights: Floats

    def __post_init__(self) -> None:
        shape = (len(self.children), (self.size + 7) // 8)
        if self.centers.shape != shape:
            raise ValueError(f"expected centers {shape}, got {self.centers.shape}")
        leaves = np.count_nonzero(self.children == 0)
        if self.weights.shape != (leaves,):
            raise ValueError(f"expected weights ({leaves},), got {self.weights.shape}")
        if not np.isfinite(self.weights).all():
            raise ValueError("expected weights that are finite, got some that are not")
        # Every node must come after its parent, or a descent would not end.
        begins = 1 + np.cumsum(self.children[:-1], dtype=np.int64)
        is_tree = len(self.children) > 1 and 1 + int(self.children.sum(dtype=np.int64)) == len(self.children)
        if not is_tree or (begins <= np.arange(1, len(self.children))).any():
            raise ValueError(f"expected children that make a tree, got {len(self.children)} nodes that do not")

    def __len__(self) -> int:
        return len(self.weights)

    @property
    def words(self) -> Floats:
        """All words (W, size) as float32 descriptors of unit length; made anew each time, a kilobyte a word."""
        bits = np.unpackbits(self.centers[self.children == 0], axis=1, count=self.size)
        return (bits.astype(np.float32) * 2 - 1) * bit_value(self.size)

    def assign(self, descriptors: Floats) -> Indices:
        """Find the word (N,) of each descriptor (N, size) by its signs; the first of equally near ones.

        Raises:
            ValueError: the descriptors have another length than the words.
        """
        if len(descriptors) == 0:
            return np.empty(0, np.int64)
        if descriptors.shape[1:] != (self.size,):
            raise ValueError(f"expected descriptors (N, {self.size}), got {descriptors.shape}")
        return self.assign_bits(pack(descriptors))

    def assign_bits(self, bits: Bits) -> Indices:
        """Find the word (N,) of each descriptor of packed bits (N, ceil(size / 64))."""
        found = _descend(bits, self._numbers, self._begins, self.children, BEAM)
        return self._words_of_nodes[found]

    def require(self, kind: str) -> "VocabularyTree":
        """Return the tree itself if its words are made of features of a kind.

        Raises:
            ValueError: the words are made of other features.
        """
        if kind != self.kind:
            raise ValueError(f"expected a vocabulary of {kind} features, found one of {self.kind}; {REMEDY}")
        return self

    @cached_property
    def _numbers(self) -> Bits:
        return as_numbers(self.centers)

    @cached_property
    def _begins(self) -> Indices:
        return 1 + np.cumsum(self.children, dtype=np.int64) - self.children

    @cached_property
    def _words_of_nodes(self) -> Indices:
        return np.cumsum(self.children == 0) - 1


def pack(descriptors: Floats) -> Bits:
    """Pack the signs of descriptors (N, size) into numbers (N, ceil(size / 64))."""
    return as_numbers(np.packbits(descriptors > 0, axis=1))


def as_numbers(packed: Bytes) -> Bits:
    """Read packed bits (N, B) as numbers (N, ceil(B / 8)), the last filled up with zeros."""
    rows, size = packed.shape
    padded = np.zeros((rows, -(-size // 8) * 8), np.uint8)
    padded[:, :size] = packed
    return padded.view("<u8").astype(np.uint64, copy=False)


def as_bytes(numbers: Bits, size: int) -> Bytes:
    """Write numbers (N, K) as rows of `size` packed bits (N, ceil(size / 8)); the inverse of `as_numbers`."""
    return numbers.astype("<u8").view(np.uint8)[:, : (size + 7) // 8]


@njit(cache=True)
def _descend(queries: Bits, centers: Bits, begins: Indices, children: Bytes, beam: int) -> Indices:
    """Find the nearest node without children (N,) of each query (N, K) among those that the beam reaches.

    Args:
        queries: packed descriptors.
        centers: (C, K) packed bits of all nodes.
        begins: (C,) number of the first child of each node.
        children: (C,) number of children of each node.
        beam: number of nodes followed on each level.
    """
    found = np.empty(len(queries), np.int64)
    nodes, distances = np.empty(beam, np.int64), np.empty(beam, np.int64)
    reached, reached_distances = np.empty_like(nodes), np.empty_like(nodes)
    for k in range(len(queries)):
        nodes[0], distances[0], count, below = 0, 0, 1, True
        while below:
            reached[:count], reached_distances[:count] = nodes[:count], distances[:count]
            parents, count, below = count, 0, False
            for i in range(parents):
                node = reached[i]
                if children[node] == 0:
                    count = _keep(nodes, distances, count, node, reached_distances[i])
                for child in range(begins[node], begins[node] + children[node]):
                    count = _keep(nodes, distances, count, child, hamming(queries[k], centers[child]))
                    below = True
        found[k] = nodes[0]
    return found


@njit(cache=True)
def _keep(nodes: Indices, distances: Indices, count: int, node: int, distance: int) -> int:
    """Insert a node in order of distance, behind equal ones; a full list drops its last. Return the new number."""
    if count == len(nodes) and distance >= distances[count - 1]:
        return count
    count = min(count + 1, len(nodes))
    place = count - 1
    while place > 0 and distances[place - 1] > distance:
        nodes[place], distances[place] = nodes[place - 1], distances[place - 1]
        place -= 1
    nodes[place], distances[place] = node, distance
    return count


@njit(cache=True)
def hamming(first: Bits, second: Bits) -> int:
    """Count the bits in which two rows of numbers (K,) differ."""
    count = 0
    for k in range(len(first)):
        x = first[k] ^ second[k]
        # The sums of neighbouring bits, pairs and fours; LLVM recognises this and takes one instruction for it.
        x = x - ((x >> np.uint64(1)) & np.uint64(0x5555555555555555))
        x = (x & np.uint64(0x3333333333333333)) + ((x >> np.uint64(2)) & np.uint64(0x3333333333333333))
        x = (x + (x >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
        count += int((x * np.uint64(0x0101010101010101)) >> np.uint64(56))
    return count
