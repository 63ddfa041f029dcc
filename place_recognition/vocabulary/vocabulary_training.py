"""Training of a visual vocabulary: k-means for float descriptors, hierarchical k-majority for binary ones.

`revisit vocabulary train` uses it, and `benchmarks/default_vocabulary.py`, which made the vocabularies that ship.

k-majority clusters binary descriptors: Grana, Borghesani, Manfredi, Cucchiara, 'A fast approach for integrating ORB
descriptors in the bag of words model', SPIE 8667, 2013. Distances are Hamming's, a centre is the majority vote of its
members bit by bit, and a tie is 0 as there. The leaves of a tree of such clusters are the words: Galvez-Lopez, Tardos,
TRO 28(5) 2012, section III.
"""

import heapq
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from place_recognition.vocabulary.vocabulary import FlatVocabulary, Vocabulary
from place_recognition.vocabulary.vocabulary_file import bit_value, round_to_steps
from place_recognition.vocabulary.vocabulary_tree import BITS, VocabularyTree, as_bytes, hamming, pack

Bits = NDArray[np.uint64]
Bytes = NDArray[np.uint8]
Floats = NDArray[np.float32]
Indices = NDArray[np.int64]

BRANCHING = 10  # of the tree of binary words (Bampis et al., IROS 2016, Table III)
ROUNDS = 15  # of assignment and vote; most clusters are stable after ten


@dataclass(frozen=True)
class VocabularyTrainingConfig:
    """Size of a vocabulary and effort of its training.

    Attributes:
        words: number of words; fewer come out where the descriptors do not differ enough.
        sample: maximum number of descriptors to train on, drawn from all with equal chance.
        iterations: number of iterations of k-means.
        seed: seed of every random choice.
    """

    words: int = 10000
    sample: int = 1000000
    iterations: int = 20
    seed: int = 0

    def __post_init__(self) -> None:
        if min(self.words, self.iterations) < 1 or self.sample < self.words:
            raise ValueError(
                f"expected words and iterations from 1 and a sample of at least as many descriptors as words,"
                f" got {self.words} words, {self.iterations} iterations, a sample of {self.sample}"
            )


class DescriptorSample:
    """Reservoir sample of a stream of descriptors: bounded memory, and the same chance for each descriptor.

    Vitter, 'Random sampling with a reservoir', ACM TOMS 11(1) 1985, algorithm R.

    Attributes:
        seen: number of descriptors so far, kept or not.
    """

    def __init__(self, limit: int, seed: int) -> None:
        self._limit, self._rng = limit, np.random.default_rng(seed)
        self._kept: list[Floats] = []  # until the reservoir is full
        self._reservoir: Floats | None = None
        self.seen = 0

    @property
    def descriptors(self) -> Floats:
        """Descriptors kept so far (K, D); (0, 0) before the first."""
        if self._reservoir is not None:
            return self._reservoir
        return np.concatenate(self._kept) if self._kept else np.empty((0, 0), np.float32)

    def add(self, descriptors: Floats) -> None:
        """Take the descriptors (N, D) of one more image into account."""
        free = max(0, self._limit - self.seen)
        if free and len(descriptors):
            self._kept.append(descriptors[:free].copy())
        self.seen += min(free, len(descriptors))
        self._replace(descriptors[free:])

    def _replace(self, descriptors: Floats) -> None:
        if len(descriptors) == 0:
            return
        if self._reservoir is None:
            self._reservoir, self._kept = np.concatenate(self._kept), []
        slots = self._rng.integers(0, self.seen + 1 + np.arange(len(descriptors)))
        chosen = slots < self._limit
        self._reservoir[slots[chosen]] = descriptors[chosen]  # of equal slots the last stays, as one after the other
        self.seen += len(descriptors)


def train_vocabulary(kind: str, descriptors: Floats, config: VocabularyTrainingConfig) -> Vocabulary:
    """Cluster descriptors into words, and weigh each word by how rare it is.

    Args:
        kind: kind of the features (FeatureExtractor.kind).
        descriptors: (N, D) float32; descriptors of +-1 / sqrt(D) alone are binary and get binary words.
        config: number of words and how they are trained.

    Raises:
        ValueError: there are fewer descriptors than words.
    """
    if len(descriptors) < config.words:
        raise ValueError(
            f"expected at least {config.words} descriptors for {config.words} words, got {len(descriptors)};"
            " give more images or ask for fewer words"
        )
    if _is_binary(descriptors):
        return train_tree(kind, descriptors.shape[1], pack(descriptors), config)
    words = _float_words(descriptors, config)
    unweighted = FlatVocabulary(kind, words, np.zeros(len(words), np.float32))
    return FlatVocabulary(kind, words, inverse_document_frequencies(len(words), unweighted.assign(descriptors)))


def train_tree(kind: str, size: int, bits: Bits, config: VocabularyTrainingConfig) -> VocabularyTree:
    """Cluster binary descriptors into the words of a tree, and weigh each word by how rare it is.

    Args:
        kind: kind of the features (FeatureExtractor.kind).
        size: number of bits of a descriptor.
        bits: (N, ceil(size / 64)) packed descriptors; memory is best used by packing early.
        config: number of words and seed.
    """
    centers, children = grow_tree(bits, config.words, BRANCHING, np.random.default_rng(config.seed))
    packed, zeros = as_bytes(centers, size), np.zeros(np.count_nonzero(children == 0), np.float32)
    words = VocabularyTree(kind, size, packed, children, zeros).assign_bits(bits)
    return VocabularyTree(kind, size, packed, children, inverse_document_frequencies(len(zeros), words))


def inverse_document_frequencies(count: int, words: Indices) -> Floats:
    """Compute the weights (count,) log(N / N_i) of all words (Bampis et al., IROS 2016, eq. 3).

    Args:
        count: number of words of the vocabulary.
        words: (N,) word of each training descriptor; N_i of them are i. A word without any counts as having one.
    """
    counts = np.bincount(words, minlength=count)
    return np.log(len(words) / np.maximum(counts, 1)).astype(np.float32)


def _float_words(descriptors: Floats, config: VocabularyTrainingConfig) -> Floats:
    """Cluster by k-means (Lloyd, IEEE TIT 28(2) 1982); words are multiples of 1 / 127, as the file stores them."""
    import faiss

    k_means = faiss.Kmeans(
        descriptors.shape[1],
        config.words,
        niter=config.iterations,
        seed=config.seed,
        min_points_per_centroid=1,  # FAISS warns below 39 and samples above 256; the sample is ours to choose
        max_points_per_centroid=len(descriptors),
    )
    # One thread: the sums of a matrix product, and with them a close decision, depend on how many threads share it.
    threads = faiss.omp_get_max_threads()
    faiss.omp_set_num_threads(1)
    try:
        k_means.train(np.ascontiguousarray(descriptors, np.float32))
    finally:
        faiss.omp_set_num_threads(threads)
    return round_to_steps(np.asarray(k_means.centroids, np.float32))


def _is_binary(descriptors: Floats) -> bool:
    # The first thousand are enough: float descriptors practically never have this exact value in every number.
    return bool((np.abs(descriptors[:1000]) == bit_value(descriptors.shape[1])).all())


def grow_tree(bits: Bits, words: int, branching: int, rng: np.random.Generator) -> tuple[Bits, Bytes]:
    """Cluster binary descriptors into a tree.

    It grows where most descriptors share a leaf, not level by level: so it has any number of leaves, and the finer ones
    in dense regions.

    Args:
        bits: (N, K) packed descriptors, at least one.
        words: number of leaves; fewer come out where the descriptors do not differ enough.
        branching: maximum number of children of a node.
        rng: generator for the choice of first centres (k-means++).

    Returns:
        Centres (C, K) and numbers of children (C,) of the nodes, as `VocabularyTree` orders them.
    """
    # A tree has a root and at least a word, which is all that equal descriptors make.
    centers, children = [np.zeros_like(bits[0])], [[]]  # type: tuple[list[Bits], list[list[int]]]
    waiting: list[tuple[int, int, Indices]] = [(-len(bits), 0, np.arange(len(bits)))]
    leaves = 1
    while waiting and (leaves < words or not children[0]):
        _, node, rows = heapq.heappop(waiting)
        groups = _split(bits, rows, min(branching, words - leaves + 1), rng)
        if len(groups) == 1 and node > 0:
            continue
        leaves += len(groups) - 1
        for center, members in groups:
            heapq.heappush(waiting, (-len(members), len(centers), members))
            children[node].append(len(centers))
            centers.append(center)
            children.append([])
    order = [0]
    for node in order:
        order.extend(children[node])
    counts = [len(children[node]) for node in order]
    return np.array([centers[node] for node in order]), np.array(counts, np.uint8)


def _split(bits: Bits, rows: Indices, clusters: int, rng: np.random.Generator) -> list[tuple[Bits, Indices]]:
    """Return centre and rows of each cluster of these rows, none empty; one cluster where all are the same."""
    centers = _first_centers(bits, rows, clusters, rng)
    nearest = np.full(len(rows), -1)
    for _ in range(ROUNDS):
        if not _assign(bits, rows, centers, nearest):
            break
        _vote(bits, rows, nearest, centers)
    return [(center, rows[nearest == k]) for k, center in enumerate(centers) if (nearest == k).any()]


def _first_centers(bits: Bits, rows: Indices, clusters: int, rng: np.random.Generator) -> Bits:
    # k-means++: each next centre is drawn with a probability that grows with its squared distance from those so far.
    centers = [bits[rows[rng.integers(len(rows))]]]
    far = _distances(bits, rows, centers[0])
    while len(centers) < clusters and far.any():
        chance = np.cumsum(far.astype(np.float64) ** 2)
        centers.append(bits[rows[np.searchsorted(chance, rng.random() * chance[-1], side="right")]])
        far = np.minimum(far, _distances(bits, rows, centers[-1]))
    return np.array(centers)


@njit(cache=True)
def _distances(bits: Bits, rows: Indices, center: Bits) -> Indices:
    """Hamming distance (R,) of each of the rows (R,) of bits (N, K) to a centre (K,)."""
    distances = np.empty(len(rows), np.int64)
    for k in range(len(rows)):
        distances[k] = hamming(bits[rows[k]], center)
    return distances


@njit(cache=True)
def _assign(bits: Bits, rows: Indices, centers: Bits, nearest: Indices) -> bool:
    """Write the nearest centre (R,) of each of the rows (R,) of bits (N, K), first of equals; whether any changed."""
    changed = False
    for k in range(len(rows)):
        best, nearest_distance = 0, np.int64(BITS * bits.shape[1] + 1)
        for m in range(len(centers)):
            distance = hamming(bits[rows[k]], centers[m])
            if distance < nearest_distance:
                best, nearest_distance = m, distance
        changed |= nearest[k] != best
        nearest[k] = best
    return changed


@njit(cache=True)
def _vote(bits: Bits, rows: Indices, nearest: Indices, centers: Bits) -> None:
    """Write the majority of its members, bit by bit, as each centre (M, K); a tie is 0, without members it stays."""
    one = np.uint64(1)
    votes, members = np.zeros((*centers.shape, BITS), np.int32), np.zeros(len(centers), np.int32)
    for k in range(len(rows)):
        members[nearest[k]] += 1
        for j in range(bits.shape[1]):
            number, counts = bits[rows[k], j], votes[nearest[k], j]
            for b in range(BITS):
                counts[b] += np.int32((number >> np.uint64(b)) & one)
    for m in np.flatnonzero(members):
        for j in range(centers.shape[1]):
            centers[m, j] = 0
            for b in range(BITS):
                if 2 * votes[m, j, b] > members[m]:
                    centers[m, j] |= one << np.uint64(b)
