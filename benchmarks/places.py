"""How well and how fast places are recognised: a table for one folder of images with a truth file.

    python benchmarks/places.py IMAGES TRUTH [--way METRES_PER_IMAGE] [--poses FILE]

IMAGES is a folder of images in the natural order of their names, or a KITTI sequence folder, which holds image_0.
TRUTH is a .npz with `truth` or the authors' .mat.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from place_benchmarks import Stopwatch, image_files

from place_recognition.belief.judge import Judge
from place_recognition.evaluation.ground_truth import load_truth
from place_recognition.evaluation.precision_recall import accepted_counts, precision_recall
from place_recognition.image_processing.features import SharedFeatures
from place_recognition.image_processing.surf import Surf
from place_recognition.map import tracked_words as tracking
from place_recognition.map.word_tree import GrowingWordIndex
from place_recognition.paradigms import tracked_words as paradigm
from place_recognition.recognizer import Belief

# stage: (module or class, function) as they are looked up when the recogniser runs
STAGES = {
    "features (SURF)": (Surf, "extract"),
    "optical flow (KLT)": (tracking, "optical_flow"),
    "guided selection": (tracking, "select_guided"),
    "nearest words": (GrowingWordIndex, "nearest"),
    "votes": (paradigm, "count_votes"),
    "judge": (Judge, "judge"),
    "all": (paradigm.TrackedWords, "observe"),
}


def ways(count: int, step: float, poses: Path | None) -> np.ndarray:
    """Way driven (count,) up to each image, metres: from KITTI poses, or equal steps."""
    if poses is None:
        return step * np.arange(count)
    positions = np.loadtxt(poses).reshape(-1, 3, 4)[:, :, 3]
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1))])


def recognise(recognizer: paradigm.TrackedWords, files: list[Path], way: np.ndarray) -> Iterator[Belief]:
    """Beliefs of all images."""
    for i, file in enumerate(files):
        yield from recognizer.observe(i, cv2.imread(str(file), cv2.IMREAD_GRAYSCALE), float(way[i]))
    yield from recognizer.finish()


def report(beliefs: list[Belief], truth: np.ndarray, words: int) -> None:
    """Print the figures of recognition."""
    print(f"{len(beliefs)} images, {int(truth.any(axis=1).sum())} of them with a true match, {words} words")
    for tolerance in (0, 10):
        curve = precision_recall(beliefs, truth, tolerance)
        right, wrong = accepted_counts(beliefs, truth, tolerance)
        print(
            f"tolerance {tolerance:2d}: R@P100 {curve.recall_at_full_precision:.4f}  AP {curve.average_precision:.4f}  "
            f"threshold {curve.threshold_at_full_precision}  accepted {right} true {wrong} false"
        )


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("images", type=Path)
    parser.add_argument("truth", type=Path)
    parser.add_argument("--way", type=float, default=float("nan"), help="metres from image to image, if known")
    parser.add_argument("--poses", type=Path, help="KITTI poses to measure the way by")
    arguments = parser.parse_args()

    files = image_files(arguments.images)
    truth = load_truth(arguments.truth)
    Surf().extract(np.zeros((64, 64), np.uint8))  # compile, or load what was compiled
    stopwatch = Stopwatch()
    for stage, (owner, name) in STAGES.items():
        stopwatch.watch(stage, owner, name)
    recognizer = paradigm.TrackedWords(SharedFeatures(Surf()))
    beliefs = list(recognise(recognizer, files, ways(len(files), arguments.way, arguments.poses)))
    report(beliefs, truth, recognizer.word_count)
    print(f"{'ms a call':20s} {'median':>8s} {'p99':>8s} {'an image':>8s}")
    for stage in STAGES:
        calls = np.array(stopwatch.milliseconds[stage] or [0.0])
        print(f"{stage:20s} {np.median(calls):8.2f} {np.percentile(calls, 99):8.2f} {calls.sum() / len(files):8.2f}")


if __name__ == "__main__":
    main()
