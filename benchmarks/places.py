"""Accuracy and speed of place recognition: one line for each paradigm over one folder of images.

    python benchmarks/places.py SOURCE [TRUTH] [--paradigms NAME ...] [--repeat N]

SOURCE is a KITTI root or a folder of images; TRUTH a .mat, a .npz with `truth`, or poses. Times are milliseconds for
an image, median (99th percentile): of the features, of all the rest, and of both; and the mean of both, which alone is
fair to paradigms that answer for many images at once. Each time is the minimum of N repetitions, because other work of
the machine can only add time. Reading images is not counted. With --growth also the medians over each fifth of the
images: the cost of a query as the map grows.
"""

import argparse

import numpy as np
from command_line import existing, run_script
from numpy.typing import NDArray

from place_recognition.paradigms.registry import PARADIGMS, ParadigmsConfig
from slam.datasets.formats.image_sequence import ImageSequence
from slam.datasets.formats.kitti import open_image_sequence
from slam.evaluation.place_metrics import evaluate_places
from slam.evaluation.revisit_truth_files import RevisitTruth, check_truth_size, read_revisit_truth
from slam.pipeline.place_recognition import PlaceRecognitionRun, RecognizerFactory, run_recognizer, stage_times

Array = NDArray[np.float64]
STAGES = ("features", "place recognition")
PARTS = 5


def main() -> None:
    """Run the benchmark."""
    given = parser().parse_args()
    images, truth = open_image_sequence(given.source, given.sequence), RevisitTruth(None, "none")
    if given.truth is not None:
        truth = read_revisit_truth(given.truth)
        check_truth_size(truth, len(images), given.source)
    print(f"{len(images)} images of {images[0].shape[1]} x {images[0].shape[0]}; ground truth: {truth.origin}")
    print(f"{'paradigm':20} {'R@P100':>7} {'AP':>7} {'true':>5} {'false':>5} {'map MB':>7}", end="")
    print(f" {'features':>14} {'recognition':>14} {'total':>14} {'mean':>6}")
    for paradigm in given.paradigms:
        runs = [drive(images, paradigm, given.vocabulary) for _ in range(given.repeat)]
        print(line(paradigm, runs, truth))
        if given.growth:
            print(growth(runs))


def parser() -> argparse.ArgumentParser:
    """Parse the command line."""
    made = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("source", type=existing)
    made.add_argument("truth", type=existing, nargs="?")
    made.add_argument("--sequence")
    made.add_argument("--vocabulary", default="")
    made.add_argument("--paradigms", nargs="+", default=list(PARADIGMS), choices=PARADIGMS, metavar="NAME")
    made.add_argument("--repeat", type=int, default=1)
    made.add_argument("--growth", action="store_true")
    return made


def drive(images: ImageSequence, paradigm: str, vocabulary: str) -> PlaceRecognitionRun:
    """Recognise places in all images once."""
    factory = RecognizerFactory(paradigm, ParadigmsConfig(vocabulary=vocabulary))
    return run_recognizer(images, factory, lambda done, total: None, lambda: False)


def line(paradigm: str, runs: list[PlaceRecognitionRun], truth: RevisitTruth) -> str:
    """Format the figures of one paradigm."""
    section = evaluate_places(paradigm, runs[0].beliefs, truth.matrix, runs[0].size).section
    names = ("recall_at_100_precision", "average_precision")
    ratios = " ".join(f"{'-' if section[name] is None else f'{section[name]:.4f}':>7}" for name in names)
    counts = " ".join(f"{section[name] if section[name] is not None else '-':>5}" for name in _COUNTS)
    size = f"{float(str(section['map_bytes'])) / 1e6:7.1f}"
    spent = " ".join(f"{_spent(runs, stages):>14}" for stages in (STAGES[:1], STAGES[1:], STAGES))
    mean = min(float(_total(run, STAGES).mean()) for run in runs)
    return f"{paradigm:20} {ratios} {counts} {size} {spent} {mean:6.1f}"


def growth(runs: list[PlaceRecognitionRun]) -> str:
    """Format the median times of recognition alone over each part of the images."""
    parts = [np.array_split(_total(run, STAGES[1:]), PARTS) for run in runs]
    medians = [min(float(np.median(run[part])) for run in parts) for part in range(PARTS)]
    return "  recognition over the drive, ms: " + " ".join(f"{median:.1f}" for median in medians)


_COUNTS = ("true_positives", "false_positives")


def _spent(runs: list[PlaceRecognitionRun], stages: tuple[str, ...]) -> str:
    median, p99 = np.min([np.percentile(_total(run, stages), (50, 99)) for run in runs], axis=0)
    return f"{median:.1f} ({p99:.0f})"


def _total(run: PlaceRecognitionRun, stages: tuple[str, ...]) -> Array:
    times = stage_times(run)
    return np.sum([times.get(stage, np.zeros(run.images)) for stage in stages], axis=0)


if __name__ == "__main__":
    run_script(main)
