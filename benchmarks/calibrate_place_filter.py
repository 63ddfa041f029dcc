"""Likelihood ratios of candidates, counted on drives with known revisits: the tables of `likelihood_ratios`.

    python benchmarks/calibrate_place_filter.py SOURCE TRUTH [SOURCE TRUTH ...] [--paradigms NAME ...]

SOURCE is a KITTI root or a folder of images; TRUTH a .mat, a .npz with `truth`, or poses. For each paradigm the
proposed candidates of every image are verified. One within the truth counts as true, one more than 20 images off as
false, the rest not at all. Printed are, for bins of the evidence of geometry and of the paradigm's own score, the
numbers of both and log10 of the ratio of their shares. Use drives that judge nothing.
"""

import argparse
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from command_line import existing, run_script
from numpy.typing import NDArray

from place_recognition.image_processing.surf import Surf
from place_recognition.map.image_history import ImageHistory
from place_recognition.paradigms.registry import PARADIGMS, ParadigmsConfig
from place_recognition.recognizer import NullMatrixSink, ObservedImage, Proposals
from place_recognition.verification.candidate_verification import CandidateVerificationConfig, verify_candidates
from place_recognition.verification.present_view import PresentView
from slam.datasets.formats.kitti import open_image_sequence
from slam.evaluation.revisit_truth_files import read_revisit_truth

EVIDENCE_BINS = (0.0, 0.01, 2.0, 5.0, 10.0, 20.0, 30.0, 45.0, 60.0, 100.0, np.inf)
OWN_QUANTILES = (0, 5, 10, 20, 30, 40, 50, 60, 70, 80, 90, 95, 98, 100)
FALSE_DISTANCE = 20  # images from the nearest true one

Truth = NDArray[np.bool_]


def main() -> None:
    """Count and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("drives", type=existing, nargs="+", metavar="SOURCE TRUTH")
    parser.add_argument("--paradigms", nargs="+", default=list(PARADIGMS)[:4], choices=PARADIGMS)
    given = parser.parse_args()
    for name in given.paradigms:
        evidence: list[tuple[bool, float]] = []
        own: list[tuple[bool, float]] = []
        for source, truth in zip(given.drives[::2], given.drives[1::2], strict=True):
            count_drive(name, source, truth, evidence, own)
        show(f"{name}: evidence of geometry", evidence, np.array(EVIDENCE_BINS))
        show(f"{name}: own score", own, np.unique(np.percentile([score for _, score in own], OWN_QUANTILES)))


def count_drive(
    name: str, source: Path, truth_file: Path, evidence: list[tuple[bool, float]], own: list[tuple[bool, float]]
) -> None:
    """Add the candidates of one drive to the counts."""
    images, truth = open_image_sequence(source, None), read_revisit_truth(truth_file).matrix
    assert truth is not None
    surf, history = Surf(), ImageHistory()
    view = PresentView(history)
    proposer = PARADIGMS[name](history, surf.kind, ParadigmsConfig(), NullMatrixSink())
    proposals: list[Proposals] = []
    for location in range(len(images)):
        features = surf.extract(images[location])
        history.add(location, features, float("nan"))
        proposals += proposer.observe(ObservedImage(location, images[location], features, float("nan"), view.advance()))
    config = CandidateVerificationConfig(early_stop_evidence=np.inf)
    for each in proposals + proposer.finish():
        allowed = config.max_candidates
        own += label(zip(each.locations[:allowed], each.scores[:allowed], strict=True), truth[each.query])
        results = verify_candidates(history.images, each.query, each.locations, each.last_matchable, config)
        evidence += label(((result.location, result.evidence) for result in results), truth[each.query])


def label(candidates: Iterable[tuple[int, float]], row: Truth) -> list[tuple[bool, float]]:
    """Return (is true, value) of the candidates (location, value) that are clearly true or clearly false."""
    columns, kept = np.flatnonzero(row), []
    for location, value in candidates:
        distance = int(np.abs(columns - location).min()) if len(columns) else FALSE_DISTANCE + 1
        if distance == 0 or distance > FALSE_DISTANCE:
            kept.append((distance == 0, float(value)))
    return kept


def show(title: str, values: list[tuple[bool, float]], edges: NDArray[np.float64]) -> None:
    """Print the counts of each bin and the ratio of the shares."""
    is_true, value = np.array([v[0] for v in values]), np.array([v[1] for v in values])
    counts = [np.histogram(value[is_true == kind], edges)[0] for kind in (True, False)]
    print(f"\n{title}: {is_true.sum()} true, {(~is_true).sum()} false")
    for k in range(len(edges) - 1):
        shares = [(count[k] + 0.5) / max(count.sum(), 1) for count in counts]  # half a count: none of few is not never
        print(f"  {edges[k]:9.2f} .. {edges[k + 1]:9.2f} {counts[0][k]:7d} {counts[1][k]:7d}", end="")
        print(f"  {np.log10(shares[0] / shares[1]):6.2f}")


if __name__ == "__main__":
    run_script(main)
