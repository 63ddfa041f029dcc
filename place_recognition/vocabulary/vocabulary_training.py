"""Training of a visual vocabulary: k-means for float descriptors, hierarchical k-majority for binary ones.

`revisit vocabulary train` uses it, and `benchmarks/default_vocabulary.py`, which made the vocabulary that ships.

k-majority clusters binary descriptors: Grana, Borghesani, Manfredi, Cucchiara, 'A fast approach for integrating ORB
descriptors in the bag of words model', SPIE 8667, 2013. Distances are Hamming's, a centre is the majority vote of its
members bit by bit, and a tie is 0 as there. The leaves of a tree of such clusters are the words: Galvez-Lopez, Tardos,
TRO 28(5) 2012, section III.
"""

import heapq
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from place_recognition.vocabulary.vocabulary import Vocabulary
from place_recognition.vocabulary.vocabulary_file import bit_value, round_to_steps

Bits = NDArray[np.bool_]
Floats = NDArray[np.float32]
Indices = NDArray[np.int64]

BRANCHING = 10  # of the tree of binary words (Bampis et al., IROS 2016, Table III)
ROUNDS = 15  # of assignment and vote; most clusters are stable after ten
ROWS = 65536  # descriptors compared at a time: as float32 they take four times the memory of their bytes


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
    make_words = _binary_words if _is_binary(descriptors) else _float_words
    words = make_words(descriptors, config)
    unweighted = Vocabulary(kind, words, np.zeros(len(words), np.float32))
    return Vocabulary(kind, words, inverse_document_frequencies(unweighted, descriptors))


def inverse_document_frequencies(vocabulary: Vocabulary, descriptors: Floats) -> Floats:
    """Compute the weights (W,) log(N / N_i) of all words (Bampis et al., IROS 2016, eq. 3).

    N is the number of descriptors, N_i the number of those nearest to word i. A word without any counts as having one.
    """
    counts = np.bincount(vocabulary.assign(descriptors), minlength=len(vocabulary))
    return np.log(len(descriptors) / np.maximum(counts, 1)).astype(np.float32)


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


def _binary_words(descriptors: Floats, config: VocabularyTrainingConfig) -> Floats:
    size = descriptors.shape[1]
    bits = k_majority(descriptors > 0, config.words, BRANCHING, np.random.default_rng(config.seed))
    return np.where(bits, bit_value(size), -bit_value(size)).astype(np.float32)


def _is_binary(descriptors: Floats) -> bool:
    # The first thousand are enough: float descriptors practically never have this exact value in every number.
    return bool((np.abs(descriptors[:1000]) == bit_value(descriptors.shape[1])).all())


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
    centers = _first_centers(bits, clusters, rng)
    nearest = np.full(len(bits), -1)
    for _ in range(ROUNDS):
        before, nearest = nearest, _nearest(bits, centers)
        if np.array_equal(before, nearest):
            break
        centers = np.array([_vote(bits[nearest == k]) for k in np.unique(nearest)])
    return [np.flatnonzero(nearest == k) for k in np.unique(nearest)]


def _first_centers(bits: Bits, clusters: int, rng: np.random.Generator) -> Bits:
    # k-means++: each next centre is drawn with a probability that grows with its squared distance from those so far.
    centers = [bits[rng.integers(len(bits))]]
    far = _hamming(bits, centers[0])
    while len(centers) < clusters and far.any():
        chance = np.cumsum(far.astype(np.float64) ** 2)
        centers.append(bits[np.searchsorted(chance, rng.random() * chance[-1], side="right")])
        far = np.minimum(far, _hamming(bits, centers[-1]))
    return np.array(centers)


def _vote(bits: Bits) -> Bits:
    return bits.sum(axis=0) * 2 > len(bits)


def _hamming(bits: Bits, center: Bits) -> Indices:
    return np.count_nonzero(bits != center, axis=1)


def _nearest(bits: Bits, centers: Bits) -> Indices:
    """Find the centre (N,) at the least Hamming distance."""
    # Agreeing bits are counted by a matrix product; its whole numbers are exact in any order of summation.
    signs = centers.astype(np.float32).T * 2 - 1
    zeros = np.count_nonzero(~centers, axis=1)
    blocks = (bits[begin : begin + ROWS].astype(np.float32) for begin in range(0, len(bits), ROWS))
    return np.concatenate([(block @ signs + zeros).argmax(axis=1) for block in blocks])
