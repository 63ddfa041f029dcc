"""How well a vocabulary serves a drive: `python benchmarks/vocabulary_quality.py SOURCE [--ground-truth LOOPS]`.

SOURCE is a folder of images or a KITTI root (`--sequence`). For the published vocabulary, the default one, and the
published one with random centres as a control, it prints

* the visual word variance (Bampis et al., IJRR 2018): the share of the distinct words of an image that the k images
  before it have not shown; 10th, 50th and 90th percentile; and of an image a third of the drive away;
* the lengths of the sequences that end where it exceeds 0.75, literally, and with at least 2 and at most 15 images;
* with a ground truth, how well the plain L2 score of the word vectors of single images finds the revisits among the
  images before the first revisit: R@1, and the share found at 100 % precision. The score as printed in equation 4.6 and
  the one scaled to [0, 1] order all pairs alike, so both have the same figures.
"""

import argparse
import time
from dataclasses import replace

import numpy as np
from command_line import existing, run_script
from numpy.typing import NDArray

from place_recognition.evaluation.revisit_ground_truth import load_truth
from place_recognition.image_processing.extractors import Brief
from place_recognition.image_processing.local_features import FeatureExtractor
from place_recognition.image_processing.surf import Surf, SurfConfig
from place_recognition.vocabulary.tf_idf import word_vector
from place_recognition.vocabulary.vocabulary import Vocabulary, default_vocabulary, published_vocabulary
from place_recognition.vocabulary.vocabulary_tree import VocabularyTree
from slam.datasets.dataset import DatasetSpec
from slam.datasets.formats.registry import open_images

Indices = NDArray[np.int64]

LIMIT = 0.75
BEFORE = (1, 2, 3, 5, 10, 20)  # images


def main() -> None:
    """Describe the images once a kind of features, and print the figures of each vocabulary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", type=existing)
    parser.add_argument("--sequence")
    parser.add_argument("--ground-truth", type=existing)
    parser.add_argument("--images", type=int, help="use the first images only")
    arguments = parser.parse_args()
    images = open_images(DatasetSpec(arguments.source.absolute(), arguments.sequence, fps=10.0))
    count = min(len(images), arguments.images or len(images))
    truth = load_truth(arguments.ground_truth) if arguments.ground_truth else None
    published = published_vocabulary()
    for extractor, vocabularies in (
        (Brief(), {"published": published, "control": with_random_centers(published)}),
        (Surf(SurfConfig(300)), {"default": default_vocabulary()}),
    ):
        described = describe(extractor, [images[k] for k in range(count)])
        for name, vocabulary in vocabularies.items():
            words, milliseconds = timed(vocabulary.require(extractor.kind), described)
            print(f"{name}: {len(vocabulary)} words of {vocabulary.kind}, assigned in {milliseconds:.2f} ms an image")
            print_variances(words)
            if truth is not None:
                print_revisits(words, vocabulary, np.asarray(truth) > 0)


def with_random_centers(vocabulary: Vocabulary) -> VocabularyTree:
    """A tree of the same shape that has learnt nothing."""
    assert isinstance(vocabulary, VocabularyTree)
    random = np.random.default_rng(0).integers(0, 256, vocabulary.centers.shape, dtype=np.uint8)
    return replace(vocabulary, centers=random)


def describe(extractor: FeatureExtractor, images: list[NDArray[np.uint8]]) -> list[NDArray[np.float32]]:
    """Descriptors of each image."""
    return [extractor.extract(image).descriptors for image in images]


def timed(vocabulary: Vocabulary, described: list[NDArray[np.float32]]) -> tuple[list[Indices], float]:
    """Words of each image, and the median processor time of an image in milliseconds."""
    words, times = [], []
    for descriptors in described:
        begin = time.process_time()
        words.append(vocabulary.assign(descriptors))
        times.append(time.process_time() - begin)
    return words, 1000 * float(np.median(times))


def print_variances(words: list[Indices]) -> None:
    """Print variances and lengths of sequences."""
    for k in BEFORE:
        low, middle, high = np.percentile(
            [variance(words[i], words[i - k : i]) for i in range(20, len(words))], [10, 50, 90]
        )
        print(f"  against {k:2d} images before: {low:.2f} {middle:.2f} {high:.2f}")
    third = len(words) // 3
    other = [variance(words[(i + third) % len(words)], words[i - 3 : i]) for i in range(3, len(words))]
    print(
        "  a third of the drive away, 3 images: "
        + " ".join(f"{value:.2f}" for value in np.percentile(other, [1, 10, 50]))
    )
    for least, most in ((1, len(words)), (2, 15)):
        lengths = sequence_lengths(words, least, most)
        print(
            f"  {least} to {most} images: {len(lengths)} sequences, mean {np.mean(lengths):.1f},"
            f" median {np.median(lengths):.0f}, longest {max(lengths)};"
            f" the limit ended {np.count_nonzero(lengths[:-1] < most)}"
        )


def variance(image: Indices, shown: list[Indices]) -> float:
    """Share of the distinct words of an image that other images have not shown."""
    distinct = np.unique(image)
    return 1 - float(np.isin(distinct, np.concatenate(shown)).mean()) if len(distinct) else 0.0


def sequence_lengths(words: list[Indices], least: int, most: int) -> Indices:
    """Lengths of the sequences of a drive."""
    begins = [0]
    for i in range(1, len(words)):
        length = i - begins[-1]
        if length >= most or (length >= least and variance(words[i], words[begins[-1] : i]) > LIMIT):
            begins.append(i)
    return np.diff([*begins, len(words)])


def print_revisits(words: list[Indices], vocabulary: Vocabulary, truth: NDArray[np.bool_]) -> None:
    """Print how well single images find their revisits among the images before the first of them."""
    queries = np.flatnonzero(truth.any(axis=1))
    known = int(queries[0])
    vectors = [word_vector(image, vocabulary.weights) for image in words]
    cosines = np.array([[vectors[q].cosine(vectors[k]) for k in range(known)] for q in queries])
    best = cosines.argmax(axis=1)
    right, score = truth[queries, best], cosines.max(axis=1)
    worst = score[~right].max(initial=-1.0)
    rightly = np.where(truth[queries][:, :known], cosines, -1).max(axis=1)
    print(
        f"  revisits: {len(queries)}, R@1 {right.mean():.3f}, R@P100 {(right & (score > worst)).mean():.3f};"
        f" cosine {np.median(rightly):.3f} of the right image, {np.median(cosines):.3f} of others"
    )


if __name__ == "__main__":
    run_script(main)
