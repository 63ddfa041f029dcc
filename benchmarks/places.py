"""Accuracy and speed of place recognition: one line for each paradigm, and each peer, over one folder of images.

    python benchmarks/places.py SOURCE [TRUTH] [--paradigms NAME ...] [--repeat N] [--dbow FOLDER] [--ibow-lcd FILE]

SOURCE is a KITTI root or a folder of images; TRUTH a .mat, a .npz with `truth`, or poses. Times are milliseconds for
an image, median (99th percentile): of the features, of all the rest, and of both; and the mean of both, which alone is
fair to paradigms that answer for many images at once. Each time is the minimum of N repetitions, because other work of
the machine can only add time. Reading images is not counted. With --growth also the medians over each fifth of the
images: the cost of a query as the map grows.

With TRUTH the last lines are the control, which proposes random earlier images to the same geometry and decision, and
the peers: with --dbow a bag of binary words (dbow_places.py; the script makes its environment in --out), whose
vocabulary is trained on the images of FOLDER, which must show other places; with --ibow-lcd the output of iBoW-LCD, a
line for each image: its number, its status (0: a loop), the number of the matched image, and, if there is a fourth
number, the inliers, which are the score.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from command_line import existing, run_script
from numpy.typing import NDArray
from peer_programs import HERE, PeerError, make_environment, run_measured

from place_recognition.paradigms.registry import PARADIGMS, ParadigmsConfig
from place_recognition.recognizer import Belief
from slam.datasets.formats.image_sequence import ImageSequence
from slam.datasets.formats.kitti import open_image_sequence
from slam.errors import DataError
from slam.evaluation.place_metrics import evaluate_places
from slam.evaluation.revisit_truth_files import RevisitTruth, check_truth_size, read_revisit_truth
from slam.io.matches import read_matches
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
    control: Sequence[Belief] | None = None
    for paradigm in given.paradigms:
        runs = [drive(images, paradigm, given.vocabulary) for _ in range(given.repeat)]
        control = runs[0].control if control is None else control
        print(line(paradigm, runs, truth), flush=True)
        if given.growth:
            print(growth(runs))
    if given.truth is not None:
        print(peer_line("random images", control or (), truth))
        print_peers(given, images, truth)


def print_peers(given: argparse.Namespace, images: ImageSequence, truth: RevisitTruth) -> None:
    """Print the lines of the peers that the command line names."""
    if given.ibow_lcd is not None:
        print(peer_line("iBoW-LCD", read_ibow_lcd(given.ibow_lcd), truth))
    if given.dbow is not None:
        try:
            print(peer_line("pydbow", run_dbow(images, given.dbow, given.out), truth))
        except PeerError as error:
            print(f"{'pydbow':20} {error}")


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
    made.add_argument("--dbow", type=existing, metavar="FOLDER")
    made.add_argument("--ibow-lcd", type=existing, metavar="FILE")
    made.add_argument("--out", type=Path, default=Path("runs/peers"), help="environment of the peer, and its last run")
    return made


def drive(images: ImageSequence, paradigm: str, vocabulary: str) -> PlaceRecognitionRun:
    """Recognise places in all images once."""
    factory = RecognizerFactory(paradigm, ParadigmsConfig(vocabulary=vocabulary), control_seed=0)
    return run_recognizer(images, factory, lambda done, total: None, lambda: False)


def line(paradigm: str, runs: list[PlaceRecognitionRun], truth: RevisitTruth) -> str:
    """Format the figures of one paradigm."""
    section = evaluate_places(paradigm, runs[0].beliefs, truth.matrix, runs[0].size).section
    size = f"{float(str(section['map_bytes'])) / 1e6:7.1f}"
    spent = " ".join(f"{_spent(runs, stages):>14}" for stages in (STAGES[:1], STAGES[1:], STAGES))
    mean = min(float(_total(run, STAGES).mean()) for run in runs)
    return f"{_scores(paradigm, section)} {size} {spent} {mean:6.1f}"


def peer_line(name: str, beliefs: Sequence[Belief], truth: RevisitTruth) -> str:
    """Format the accuracy of what another program answered."""
    return _scores(name, evaluate_places(name, beliefs, truth.matrix).section)


def _scores(name: str, section: dict[str, object]) -> str:
    ratios = [section[ratio] for ratio in ("recall_at_100_precision", "average_precision")]
    counts = [section[count] for count in ("true_positives", "false_positives")]
    cells = [*(f"{'-' if ratio is None else f'{ratio:.4f}':>7}" for ratio in ratios)]
    return " ".join([f"{name:20}", *cells, *(f"{'-' if count is None else count:>5}" for count in counts)])


def read_ibow_lcd(path: Path) -> list[Belief]:
    """Read the output of iBoW-LCD: query, status (0 for a loop), match and, where there are four numbers, inliers.

    Raises:
        DataError: the file has other columns, or a match that is not earlier than its query.
    """
    try:
        rows = np.loadtxt(path, ndmin=2)
        queries, status, matches = rows[:, :3].T.astype(int)
        scores = rows[:, 3] if rows.shape[1] > 3 else np.ones(len(rows))
    except ValueError as error:
        raise DataError(f"{path}: expected three or four numbers a line, found {error}; write it again") from None
    found = list(zip(queries.tolist(), matches.tolist(), scores.tolist(), (status == 0).tolist(), strict=True))
    late = [query for query, match, _, is_loop in found if is_loop and not 0 <= match < query]
    if late:
        raise DataError(
            f"{path}: expected matches earlier than their query, found none for {late[0]}; correct the line"
        )
    return [
        Belief(query, match, score, accepted=True) if is_loop else Belief(query, None, 0.0, accepted=False)
        for query, match, score, is_loop in found
    ]


def run_dbow(images: ImageSequence, training: Path, out: Path) -> tuple[Belief, ...]:
    """Run the bag of binary words in an environment of its own.

    Raises:
        PeerError: it cannot be installed, or fails.
    """
    python = make_environment(out / "pydbow", ("pydbow", "opencv-python-headless"))
    out.mkdir(parents=True, exist_ok=True)
    lists = {"images": images, "training": open_image_sequence(training)}
    files = [out / f"dbow_{name}.txt" for name in lists]
    for file, sequence in zip(files, lists.values(), strict=True):
        file.write_text("".join(f"{path.absolute()}\n" for path in sequence.files))
    table = out / "dbow_matches.csv"
    run_measured([str(python), str(HERE / "dbow_places.py"), *map(str, files), str(table)], out / "dbow_run")
    return read_matches(table)


def growth(runs: list[PlaceRecognitionRun]) -> str:
    """Format the median times of recognition alone over each part of the images."""
    parts = [np.array_split(_total(run, STAGES[1:]), PARTS) for run in runs]
    medians = [min(float(np.median(run[part])) for run in parts) for part in range(PARTS)]
    return "  recognition over the drive, ms: " + " ".join(f"{median:.1f}" for median in medians)


def _spent(runs: list[PlaceRecognitionRun], stages: tuple[str, ...]) -> str:
    median, p99 = np.min([np.percentile(_total(run, stages), (50, 99)) for run in runs], axis=0)
    return f"{median:.1f} ({p99:.0f})"


def _total(run: PlaceRecognitionRun, stages: tuple[str, ...]) -> Array:
    times = stage_times(run)
    return np.sum([times.get(stage, np.zeros(run.images)) for stage in stages], axis=0)


if __name__ == "__main__":
    run_script(main)
