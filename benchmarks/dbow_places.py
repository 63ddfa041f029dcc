"""A bag of binary words over a list of images, by the package `pydbow`: a peer of the place recognition.

    python benchmarks/dbow_places.py IMAGES TRAINING OUT [--gap N]

`places.py --dbow` makes an environment for it and runs it; it imports neither Revisit nor its libraries. IMAGES and
TRAINING are text files with the path of an image on each line, in the order of the drive; the vocabulary is trained on
the second, which must not be of the same place. OUT becomes a table with the columns query, match and score: for each
image that of the N-th image before it, and of those before that one, which has the highest score. There is no check by
geometry or time.
"""

import argparse
import csv
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

BRANCHES, LEVELS = 10, 3
TRAINING_IMAGES = 20  # pydbow is written in Python: more would take hours
DEFAULT_GAP = 20


def read_images(file: Path) -> list[NDArray[np.uint8]]:
    """Read the grey images of a list."""
    return [cv2.imread(line, cv2.IMREAD_GRAYSCALE) for line in file.read_text().splitlines()]


def describe(dbow: Any, image: NDArray[np.uint8]) -> list[Any]:
    """Return the descriptors of an image as objects of pydbow."""
    _, descriptors = cv2.ORB_create().detectAndCompute(image, None)
    return [dbow.ORB.from_cv_descriptor(row) for row in (() if descriptors is None else descriptors)]


def match(dbow: Any, vocabulary: Any, images: list[NDArray[np.uint8]], gap: int) -> list[tuple[int, int, float]]:
    """Match each image with those at least `gap` images before it: query, match and score."""
    vectors, found = [], []
    for query, image in enumerate(images):
        descriptors = describe(dbow, image)
        vectors.append(vocabulary.descs_to_bow(descriptors) if descriptors else None)
        earlier = [(i, vectors[i]) for i in range(query - gap + 1) if vectors[i] is not None]
        if vectors[query] is not None and earlier:
            scores = [vectors[query].score(vector) for _, vector in earlier]
            best = int(np.nanargmax(scores))
            found.append((query, earlier[best][0], float(scores[best])))
    return found


def main() -> None:
    """Train, match and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("images", "training", "out"):
        parser.add_argument(name, type=Path)
    parser.add_argument("--gap", type=int, default=DEFAULT_GAP)
    given = parser.parse_args()
    import dbow

    np.random.seed(0)  # noqa: NPY002, pydbow draws from NumPy's own generator
    training = read_images(given.training)
    chosen = np.unique(np.linspace(0, len(training) - 1, min(TRAINING_IMAGES, len(training))).round().astype(int))
    vocabulary = dbow.Vocabulary([training[i] for i in chosen], BRANCHES, LEVELS)
    with given.out.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("query", "match", "score"))
        writer.writerows(match(dbow, vocabulary, read_images(given.images), given.gap))


if __name__ == "__main__":
    main()
