"""Train a vocabulary of ORB descriptors for programs that read the text format of DBoW2, such as ORB-SLAM3.

    python benchmarks/orb_vocabulary.py FOLDER... --out FILE [--images N]

Each FOLDER is one of images or of a KITTI sequence; at most N images, evenly spread over all, are used. They must not
be those on which the vocabulary is measured. The tree has at most 10 branches a node and 6 levels, as ORB-SLAM3's own:
k-majority (means of bits, rounded) on each level, and a node of few descriptors is a word. The weight of a word is its
inverse document frequency.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from command_line import existing, run_script
from numpy.typing import NDArray

from slam.datasets.formats.kitti import open_image_sequence
from slam.errors import DataError

Descriptors = NDArray[np.uint8]

BRANCHES, LEVELS = 10, 6
MIN_SPLIT = 20  # descriptors of a node that is divided
ROUNDS = 8  # of k-majority, which hardly changes after five
FEATURES_PER_IMAGE = 1000
DEFAULT_IMAGES = 300


@dataclass(frozen=True)
class VocabularyTree:
    """Nodes of a vocabulary in the order of their ids; the root, id 0, has no row, so row i is node i + 1.

    Attributes:
        parents: (N,) id of each node's parent, smaller than its own.
        is_word: (N,) whether the node is a leaf.
        descriptors: (N, 32) uint8, centre of each node.
        weights: (N,) inverse document frequency of words, 0 for other nodes.
    """

    parents: NDArray[np.int64]
    is_word: NDArray[np.bool_]
    descriptors: Descriptors
    weights: NDArray[np.float64]


@dataclass(frozen=True)
class _Node:
    """A node that is not divided yet: its id, level and the rows of its descriptors."""

    id: int
    level: int
    rows: NDArray[np.int64]


def distances(a: Descriptors, b: Descriptors) -> NDArray[np.int64]:
    """Hamming distances (N, M) of descriptors (N, 32) and (M, 32)."""
    wide_a, wide_b = (np.ascontiguousarray(d).view(np.uint64) for d in (a, b))
    return np.asarray(np.bitwise_count(wide_a[:, None] ^ wide_b[None]).sum(axis=2, dtype=np.int64))


def cluster(descriptors: Descriptors, rng: np.random.Generator) -> tuple[Descriptors, NDArray[np.int64]]:
    """Divide descriptors (N, 32) into at most `BRANCHES` clusters that are not empty: centres and labels (N,)."""
    unique = np.unique(descriptors, axis=0)
    centres = unique if len(unique) <= BRANCHES else _spread(unique, rng)
    for _ in range(ROUNDS):
        labels = distances(descriptors, centres).argmin(axis=1)
        kept, labels = np.unique(labels, return_inverse=True)
        centres = np.array([_majority(descriptors[labels == label]) for label in range(len(kept))])
    return centres, labels


def _spread(unique: Descriptors, rng: np.random.Generator) -> Descriptors:
    """Choose first centres that are far from each other (k-means++)."""
    chosen = [int(rng.integers(len(unique)))]
    nearest = distances(unique, unique[chosen])[:, 0]
    while len(chosen) < BRANCHES:
        weights = nearest.astype(np.float64) ** 2
        chosen.append(int(rng.choice(len(unique), p=weights / weights.sum())))
        nearest = np.minimum(nearest, distances(unique, unique[chosen[-1:]])[:, 0])
    return unique[chosen]


def _majority(descriptors: Descriptors) -> Descriptors:
    bits = np.unpackbits(descriptors, axis=1)
    return np.packbits(2 * bits.sum(axis=0, dtype=np.int64) >= len(bits))


def train(images: Sequence[Descriptors], seed: int = 0) -> VocabularyTree:
    """Train a tree on the descriptors (N_i, 32) of images."""
    rng = np.random.default_rng(seed)
    descriptors = np.concatenate(images)
    owners = np.repeat(np.arange(len(images)), [len(image) for image in images])
    parents, words, centres, weights = [], [], [], []
    waiting = [_Node(0, 0, np.arange(len(descriptors)))]
    while waiting:
        node = waiting.pop(0)
        found, labels = cluster(descriptors[node.rows], rng)
        for label, centre in enumerate(found):
            rows = node.rows[labels == label]
            ends = node.level + 1 == LEVELS or len(rows) < MIN_SPLIT or len(found) == 1
            parents.append(node.id)
            centres.append(centre)
            words.append(ends)
            weights.append(np.log(len(images) / len(np.unique(owners[rows]))) if ends else 0.0)
            if not ends:
                waiting.append(_Node(len(parents), node.level + 1, rows))
    return VocabularyTree(np.array(parents), np.array(words), np.array(centres), np.array(weights))


def write_text(path: Path, tree: VocabularyTree) -> None:
    """Write DBoW2's text format: branches, levels, scoring by L1 (0), weights TF-IDF (0); then a line for each node.

    There is no line end after the last node: ORB-SLAM3's reader would take an empty line for another node.
    """
    lines = [f"{BRANCHES} {LEVELS} 0 0"]
    for parent, word, descriptor, weight in zip(
        tree.parents, tree.is_word, tree.descriptors, tree.weights, strict=True
    ):
        lines.append(f"{parent} {int(word)} {' '.join(map(str, descriptor.tolist()))} {weight:.8g}")
    path.write_text("\n".join(lines))


def describe_images(folders: Sequence[Path], images: int) -> list[Descriptors]:
    """Extract ORB descriptors (N_i, 32) of at most so many images, evenly spread over all of the folders.

    Raises:
        DataError: no image has a descriptor.
    """
    sequences = [open_image_sequence(folder) for folder in folders]
    every = [(sequence, index) for sequence in sequences for index in range(len(sequence))]
    chosen = np.unique(np.linspace(0, len(every) - 1, min(images, len(every))).round().astype(int))
    orb = cv2.ORB_create(FEATURES_PER_IMAGE)
    described = [orb.detectAndCompute(every[i][0][every[i][1]], None)[1] for i in chosen]
    found = [descriptors for descriptors in described if descriptors is not None]
    if not found:
        raise DataError(f"{folders[0]}: expected images with corners, found none; name other images for the vocabulary")
    return found


def main() -> None:
    """Train on the images of a command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=existing)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--images", type=int, default=DEFAULT_IMAGES)
    given = parser.parse_args()
    tree = train(describe_images(given.folders, given.images))
    write_text(given.out, tree)
    print(f"{len(tree.parents)} nodes, {tree.is_word.sum()} words: {given.out}")


if __name__ == "__main__":
    run_script(main)
