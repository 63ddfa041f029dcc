"""Measures the likelihood ratios of the place filter: how much likelier a score is at a revisit than at a new place.

    python benchmarks/calibrate_place_filter.py IMAGES TRUTH [IMAGES TRUTH ...] [--paradigms NAME...]

IMAGES is a folder of images, or one with image_0 in it. TRUTH is an .npz with `truth` (N, N), or a text file of poses
in KITTI's layout. No other figure may come from these drives. For each paradigm, and for random images as a control, it
prints log10 of the ratio for bins of the evidence of geometry and of the own score, with the numbers of true and false
candidates, and how many of them exceed an evidence. The tables of `place_recognition.belief.likelihood_ratios` are
drawn through these values by hand (docs/decisions/place_filter.md).
"""

import argparse
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from place_benchmarks import image_files
from scipy.ndimage import maximum_filter1d
from scipy.spatial.distance import cdist

from place_recognition.evaluation.revisit_ground_truth import load_truth, truth_from_poses
from place_recognition.image_processing.local_features import FeatureCache
from place_recognition.image_processing.surf import Surf
from place_recognition.paradigms.registry import PARADIGMS, ParadigmsConfig, make_control, make_recognizer
from place_recognition.recognizer import Belief
from place_recognition.verification.candidate_verification import CandidateVerificationConfig

Truth = NDArray[np.bool_]
# Each candidate: its evidence, its own score, whether it is true, within two images of a true one, and false.
Candidates = NDArray[np.float64]

# Distance of a false candidate, in metres where there are poses and else in images from a true one. A street straight
# ahead agrees by geometry over 30 m. What lies between true and false counts for neither.
MIN_FALSE_DISTANCE_M, MIN_FALSE_DISTANCE_IMAGES = 40.0, 60
MAX_OWN_DISTANCE = 2  # images by which a true candidate of the paradigm may miss: it proposes one of a neighbourhood
EVIDENCE_BINS = (0.0, 1e-9, 2.0, 5.0, 10.0, 20.0, 30.0, 45.0, 60.0, 100.0, math.inf)
OWN_QUANTILES = (0, 10, 20, 30, 40, 50, 60, 70, 80, 90, 95, 98, 100)
EXCEEDED = (5, 20, 40)
# Verification goes on where a recogniser would have seen enough.
CONFIG = ParadigmsConfig(verification=CandidateVerificationConfig(early_stop_evidence=math.inf))


class CandidateRecorder:
    """Keeps the verified candidates of all queries and decides nothing (a Decision)."""

    def __init__(self) -> None:
        self.recorded: list[tuple[Any, tuple[Any, ...]]] = []

    def add(self, proposals: Any, results: tuple[Any, ...]) -> list[Belief]:
        """Keep the candidates of a query."""
        self.recorded.append((proposals, results))
        return []

    def finish(self) -> list[Belief]:
        """Return nothing."""
        return []


def read_truth(path: Path) -> tuple[Truth, Truth]:
    """Return which earlier images (N, N) are true, and which are false candidates of each image."""
    if path.suffix != ".txt":
        truth = load_truth(path).astype(bool)
        return truth, ~_widened(truth, MIN_FALSE_DISTANCE_IMAGES)
    poses = np.tile(np.eye(4), (sum(1 for _ in path.open()), 1, 1))
    poses[:, :3] = np.loadtxt(path).reshape(-1, 3, 4)
    positions = poses[:, :3, 3]
    return truth_from_poses(poses).astype(bool), cdist(positions, positions) > MIN_FALSE_DISTANCE_M


def _widened(truth: Truth, images: int) -> Truth:
    return maximum_filter1d(truth.astype(np.uint8), 2 * images + 1, axis=1, mode="constant").astype(bool)


def candidates(name: str, images: Path, truth: tuple[Truth, Truth]) -> Candidates:
    """Return the verified candidates (K, 5) of a drive."""
    features = FeatureCache(Surf())
    recognizer: Any = make_recognizer(name, features, CONFIG) if name in PARADIGMS else make_control(features, CONFIG)
    recognizer._decision = recorder = CandidateRecorder()
    for k, file in enumerate(image_files(images)):
        recognizer.observe(k, cv2.imread(str(file), cv2.IMREAD_GRAYSCALE), math.nan)
    recognizer.finish()
    kinds = truth[0], _widened(truth[0], MAX_OWN_DISTANCE), truth[1]
    rows = [row for proposals, results in recorder.recorded for row in _rows(proposals, results, kinds)]
    return np.array(rows, np.float64).reshape(-1, 5)


def _rows(proposals: Any, results: tuple[Any, ...], kinds: tuple[Truth, ...]) -> Iterator[tuple[float, ...]]:
    own = dict(zip(proposals.locations, proposals.scores, strict=True))
    for result in results:
        where = proposals.query, result.location
        yield result.evidence, own.get(result.location, math.nan), *(float(kind[where]) for kind in kinds)


def show_ratios(what: str, scores: NDArray[np.float64], is_true: Truth, edges: NDArray[np.float64]) -> None:
    """Print log10 of the ratio of the shares of true and false candidates in each bin."""
    true, false = np.histogram(scores[is_true], edges)[0], np.histogram(scores[~is_true], edges)[0]
    # Half a candidate more in each bin: an empty one is no certainty.
    ratios = np.log10((true + 0.5) / max(true.sum(), 1)) - np.log10((false + 0.5) / max(false.sum(), 1))
    print(f"  {what}: {true.sum()} true, {false.sum()} false")
    for k, ratio in enumerate(ratios):
        print(f"    {edges[k]:8.3f} to {edges[k + 1]:8.3f}  {true[k]:6d} true {false[k]:6d} false  {ratio:5.1f}")


def show(name: str, found: Candidates) -> None:
    """Print the ratios of one paradigm."""
    evidence, own = found[:, :2].T
    is_true, is_near, is_false = found[:, 2:].T.astype(bool)
    print(f"\n{name}: {len(found)} candidates")
    clear = is_true | is_false
    show_ratios("geometry", evidence[clear], is_true[clear], np.array(EVIDENCE_BINS))
    for limit in EXCEEDED:
        shares = [
            100 * float((evidence[kind] > limit).mean()) if kind.any() else math.nan for kind in (is_true, is_false)
        ]
        print(f"    evidence above {limit}: {shares[0]:.2f} % of the true, {shares[1]:.2f} % of the false")
    clear = (is_near | is_false) & np.isfinite(own)
    edges = np.unique(np.percentile(own[clear], OWN_QUANTILES))
    if len(edges) > 1:
        show_ratios("own score", own[clear], is_near[clear], edges)


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("drives", type=Path, nargs="+", help="images and truth of each drive, in turn")
    parser.add_argument("--paradigms", nargs="+", choices=PARADIGMS, default=list(PARADIGMS))
    arguments = parser.parse_args()
    if len(arguments.drives) % 2:
        parser.error("expected images and truth of each drive, found an odd number of paths; add the truth")
    drives = [(images, read_truth(path)) for images, path in zip(*[iter(arguments.drives)] * 2, strict=True)]
    for name in [*arguments.paradigms, "random-images"]:
        show(name, np.concatenate([candidates(name, images, truth) for images, truth in drives]))


if __name__ == "__main__":
    main()
