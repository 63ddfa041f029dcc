"""Global descriptors by themselves: which image of one walk is most like each image of another one.

    python benchmarks/image_descriptors.py REFERENCE QUERY [--night] [--descriptors NAME ...] [--tolerance IMAGES]

Both are folders of images; image i of one shows the place of image i of the other, within the tolerance. Printed are
recall at 1, the average precision of the most similar image, ranked by its cosine and by how distinct that is, and the
processor's time of a description. `random` is the control, a vector drawn for each image. `--night` darkens the query
as night does: a bright sky goes black, a few moving lamps light some of the scene, all is warm, blurred and noisy. That
stands for night where there are no such images, and no more: it keeps the place of every shadow.
"""

import argparse
import time
from collections.abc import Sequence

import cv2
import numpy as np
from command_line import existing, run_script
from numpy.typing import NDArray

from place_recognition.image_processing.global_descriptors import GLOBAL_DESCRIPTORS, make_global_descriptor
from place_recognition.map.descriptor_database import DescriptorDatabase
from place_recognition.paradigms.whole_images import distinctness
from slam.datasets.formats.image_sequence import list_images

Image = NDArray[np.uint8]
Array = NDArray[np.float64]

RANDOM = "random"


def main() -> None:
    """Read, describe, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("reference", type=existing)
    parser.add_argument("query", type=existing)
    parser.add_argument("--night", action="store_true")
    parser.add_argument("--descriptors", nargs="+", default=[*GLOBAL_DESCRIPTORS, RANDOM])
    parser.add_argument("--tolerance", type=int, default=3)
    given = parser.parse_args()
    reference, query = (
        [cv2.cvtColor(cv2.imread(str(file)), cv2.COLOR_BGR2RGB) for file in list_images(folder)]
        for folder in (given.reference, given.query)
    )
    if given.night:
        query = [darken(image, k) for k, image in enumerate(query)]
    print("descriptor              numbers  recall@1  AP cosine  AP distinct  ms of the processor")
    for name in given.descriptors:
        measure(name, reference, query, given.tolerance)


def measure(name: str, reference: Sequence[Image], query: Sequence[Image], tolerance: int) -> None:
    """Print the row of one descriptor."""
    start = time.process_time()
    vectors = [describe(name, images, seed) for seed, images in enumerate((reference, query))]
    spent_ms = 1000 * (time.process_time() - start) / (len(reference) + len(query))
    database = DescriptorDatabase()
    for vector in vectors[0]:
        database.add(vector)
    rows = np.array([database.similarities(vector, len(reference)) for vector in vectors[1]])
    right = np.abs(rows.argmax(axis=1) - np.arange(len(rows))) <= tolerance
    precisions = [
        average_precision(scores.max(axis=1), right) for scores in (rows, np.array([distinctness(r) for r in rows]))
    ]
    print(
        f"{name[-22:]:22s} {len(vectors[0][0]):8d} {right.mean():9.3f} {precisions[0]:10.3f} {precisions[1]:12.3f}"
        f" {spent_ms:20.1f}",
        flush=True,
    )


def describe(name: str, images: Sequence[Image], seed: int) -> list[NDArray[np.float32]]:
    """Describe the images, in colour where the descriptor takes it."""
    if name == RANDOM:
        return list(np.random.default_rng(seed).normal(size=(len(images), 1000)).astype(np.float32))
    descriptor = make_global_descriptor(name)
    if descriptor.takes_color:
        return [descriptor.describe(image) for image in images]
    return [descriptor.describe(np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8)) for image in images]


def average_precision(scores: Array, right: NDArray[np.bool_]) -> float:
    """Area below the curve of the first answers of queries that all have a place: the mean precision at each right."""
    ranked = right[np.argsort(-scores, kind="stable")]
    return float((ranked * np.cumsum(ranked) / np.arange(1, len(ranked) + 1)).sum() / len(ranked))


def darken(image: Image, index: int) -> Image:
    """Make an image (H, W, 3), red first, one of night; lamps move a little from index to index."""
    noise, light = np.random.default_rng(index), image.astype(np.float32) / 255
    light = np.where(light.mean(axis=2, keepdims=True) > 0.8, np.float32(0.08) * light, light) ** 2
    height, width = image.shape[:2]
    y, x = np.mgrid[:height, :width].astype(np.float32)
    lit, lamps, phase = np.full((height, width), 0.1, np.float32), np.zeros((height, width), np.float32), 0.35 * index
    for k in range(4):
        center = (0.5 + 0.6 * np.sin(0.3 * phase + 1.7 * k)) * width, (0.1 + 0.12 * k) * height
        reach = (0.12 + 0.08 * abs(np.cos(phase + k))) * width
        lit += 0.8 * np.exp(-((x - center[0]) ** 2 + (y - center[1] - 0.3 * height) ** 2) / (2 * reach**2))
        near = ((x - center[0]) ** 2 + (y - center[1]) ** 2) / (2 * (0.012 * width) ** 2)
        lamps += 1.2 * np.exp(-near) + 0.25 * np.exp(-near / 40)
    light = (1.6 * light * lit[:, :, None] + lamps[:, :, None]) * np.array([1.15, 0.9, 0.65])
    light = cv2.GaussianBlur(light, (0, 0), 1.0) + noise.normal(0, 0.035, light.shape)
    return (255 * np.clip(light, 0, 1)).astype(np.uint8)


if __name__ == "__main__":
    run_script(main)
