"""The stages of place recognition, each measured by itself, so that readers see which of them does the work.

A recogniser proposes candidates, scores them, verifies them by geometry, and lets a temporal model decide. Of the
candidates the recall counts; each later stage names one match with a score, and has a precision-recall curve.

The confidence intervals come from a circular block bootstrap (Politis and Romano, 1992): a sample is made of whole
blocks of consecutive queries, because neighbouring images show nearly the same and are not independent. Revisit events
would be the natural blocks, but a recording has one to six of them, too few to draw from
(docs/decisions/stages_of_recognition.md). An interval tells how much luck the choice of the images was. It does not
say how another street would turn out.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from place_recognition.evaluation.precision_recall import PrecisionRecall, Truth, is_correct, precision_recall
from place_recognition.recognizer import Belief

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Weights = NDArray[np.uint16]
Interval = tuple[float, float]

CURVE_STAGES = ("own", "geometry", "temporal")  # the stages that name one match
CANDIDATE_COUNTS = (1, 5, 10)  # candidates of a query among which a true image is sought
CURVE_SUMMARIES = ("recall_at_100_precision", "area_under_curve", "average_precision")

MAX_BLOCK_IMAGES = 20  # of the bootstrap: two seconds at ten images a second
_MIN_BLOCKS = 10  # in a recording; shorter ones have shorter blocks
_NUM_SAMPLES = 1000
_PERCENTILES = (2.5, 97.5)
_CHUNK, _MAX_CHUNK_WEIGHTS = 50, 1_000_000  # samples computed at a time, and their images: 8 MB an array


@dataclass(frozen=True)
class StageResults:
    """What each stage reaches. What a recogniser does not report is left out.

    Attributes:
        candidate_recall: share of the queries with truth that have a true image among their first K candidates, by K
            of CANDIDATE_COUNTS; empty where no belief has candidates.
        curves: precision-recall curve of each stage of CURVE_STAGES that ever names a match.
    """

    candidate_recall: Mapping[int, float]
    curves: Mapping[str, PrecisionRecall]


def measure_stages(beliefs: Sequence[Belief], truth: Truth, tolerance: int = 0) -> StageResults:
    """Measure every stage that the beliefs report.

    Args:
        beliefs: one belief for each query.
        truth: (N, N) truth matrix, row = query, column = earlier image; at least one row has a true image.
        tolerance: images by which a match may miss a true one, as in `is_correct`.
    """
    revisits, recall = truth.any(axis=1), {}
    if has_candidates(beliefs):
        ranks = candidate_ranks(beliefs, truth, tolerance)
        recall = {count: float((ranks <= count).sum() / revisits.sum()) for count in CANDIDATE_COUNTS}
    curves = {stage: precision_recall(found, truth, tolerance) for stage, found in _answers(beliefs).items()}
    return StageResults(recall, curves)


def stage_intervals(beliefs: Sequence[Belief], truth: Truth, seed: int = 0) -> dict[str, dict[str, Interval]]:
    """Compute the 95 % confidence interval of each value of each stage, without tolerance.

    Args:
        beliefs: one belief for each query.
        truth: (N, N) truth matrix, as in `measure_stages`.
        seed: seed of the bootstrap; the same seed draws the same images for every recogniser and stage.

    Returns:
        For "candidates" and each stage of CURVE_STAGES that the beliefs report: interval of `recall_at_K`, and of each
        of CURVE_SUMMARIES.
    """
    weights = sample_weights(len(truth), seed)
    intervals = {stage: curve_intervals(found, truth, weights) for stage, found in _answers(beliefs).items()}
    if not has_candidates(beliefs):
        return intervals
    ranks = np.full(len(truth), np.inf)
    ranks[[belief.query for belief in beliefs]] = candidate_ranks(beliefs, truth)
    truth_rows = np.maximum(_count_weights(weights, truth.any(axis=1)), 1)
    found = {count: _count_weights(weights, ranks <= count) for count in CANDIDATE_COUNTS}
    recall = {f"recall_at_{count}": _interval(hits / truth_rows) for count, hits in found.items()}
    return {"candidates": recall} | intervals


def has_candidates(beliefs: Iterable[Belief]) -> bool:
    """Whether the recogniser reports candidates at all."""
    return any(belief.stages.candidates for belief in beliefs)


def stage_answers(beliefs: Iterable[Belief], stage: str) -> list[Belief]:
    """Return what one stage of CURVE_STAGES would answer by itself: its match with its score."""
    if stage == "own":
        return [_answer(b, next(iter(b.stages.candidates), None), b.stages.own_score) for b in beliefs]
    if stage == "geometry":
        return [_answer(b, b.stages.geometry_match, b.stages.geometry_score) for b in beliefs]
    return list(beliefs)


def candidate_ranks(beliefs: Sequence[Belief], truth: Truth, tolerance: int = 0) -> Array:
    """Return the rank (B,), from 1, of the first true candidate of each belief; infinity where none is true."""
    ranks = np.full(len(beliefs), np.inf)
    for place in reversed(range(max(CANDIDATE_COUNTS))):
        proposed = [_answer(b, next(iter(b.stages.candidates[place:]), None), 0.0) for b in beliefs]
        ranks[is_correct(proposed, truth, tolerance)] = place + 1
    return ranks


def sample_weights(images: int, seed: int = 0, samples: int = _NUM_SAMPLES) -> Weights:
    """Return how often each image occurs in each sample of the bootstrap, (samples, images).

    A sample joins blocks of consecutive images, whose first images are drawn with equal chances; the last image is
    followed by the first, so that every image is equally likely. It is as long as the recording.
    """
    block = min(MAX_BLOCK_IMAGES, max(1, images // _MIN_BLOCKS))
    starts = np.random.default_rng(seed).integers(0, images, (samples, -(-images // block)))
    weights = np.empty((samples, images), np.uint16)  # 200 MB of 100,000 images
    for sample, first in zip(weights, starts, strict=True):
        drawn = (first[:, None] + np.arange(block)).ravel()[:images] % images
        sample[:] = np.bincount(drawn, minlength=images)
    return weights


def _count_weights(weights: Weights, chosen: NDArray[np.bool_]) -> Counts:
    """Sum the weights (S, N) of the chosen images (N,) in each sample: (S,)."""
    return np.array([sample[chosen].sum(dtype=np.int64) for sample in weights], np.int64)


def curve_intervals(answers: Sequence[Belief], truth: Truth, weights: Weights) -> dict[str, Interval]:
    """Compute the confidence interval of each of CURVE_SUMMARIES for the curve of some answers.

    R@P100 hangs on the highest-scored false match alone: where a sample lacks it, the value jumps. Its interval is wide
    and lopsided for that reason, and says so rightly.

    Args:
        answers: as in `precision_recall`.
        truth: (N, N) truth matrix.
        weights: (S, N) how often each query occurs in each sample.
    """
    detected = [answer for answer in answers if answer.is_detection]
    scores = np.array([answer.score for answer in detected], np.float64)
    order = np.argsort(-scores, kind="stable")
    right = is_correct(detected, truth)[order]
    queries = np.array([answer.query for answer in detected], np.int64)[order]
    # No threshold separates equal scores: the curve has a point after the last of them.
    last = np.flatnonzero(np.append(np.diff(scores[order]) != 0, True))[: len(detected)]
    truth_rows = _count_weights(weights, truth.any(axis=1))
    sampled, chunk = [], max(min(_CHUNK, _MAX_CHUNK_WEIGHTS // weights.shape[1]), 1)
    for first in range(0, len(weights), chunk):
        chosen = weights[first : first + chunk, queries].astype(np.int64)
        counts, hits = np.cumsum(chosen, axis=1)[:, last], np.cumsum(chosen * right, axis=1)[:, last]
        sampled.append(_summarize(hits, counts, truth_rows[first : first + chunk, None]))
    return {name: _interval(values) for name, values in zip(CURVE_SUMMARIES, np.hstack(sampled), strict=True)}


def _summarize(hits: Counts, counts: Counts, truth_rows: Counts) -> Array:
    """Return CURVE_SUMMARIES (3, S) of the curves of S samples with (S, K) true and all detections at each point."""
    recall, precision = hits / np.maximum(truth_rows, 1), hits / np.maximum(counts, 1)
    gained = np.diff(recall, axis=1, prepend=0.0)
    # Before the first detection of a sample there is no precision yet; the area begins with the first one's.
    before = np.where(np.roll(counts, 1, axis=1) > 0, np.roll(precision, 1, axis=1), precision)
    before[:, :1] = precision[:, :1]
    clean = np.where(counts == hits, recall, 0.0).max(axis=1, initial=0.0)
    return np.array([clean, (gained * (before + precision) / 2).sum(axis=1), (gained * precision).sum(axis=1)])


def _answers(beliefs: Sequence[Belief]) -> dict[str, list[Belief]]:
    """Answers of each stage that the beliefs report: the last one always, another if it ever names a match."""
    answers = {stage: stage_answers(beliefs, stage) for stage in CURVE_STAGES}
    named = {stage for stage, found in answers.items() if any(answer.match is not None for answer in found)}
    return {stage: found for stage, found in answers.items() if stage in named | {"temporal"}}


def _answer(belief: Belief, match: int | None, score: float | None) -> Belief:
    if match is None or score is None:
        return Belief(belief.query, None, 0.0, accepted=False)
    return Belief(belief.query, match, score, accepted=False)


def _interval(values: Array) -> Interval:
    low, high = np.percentile(values, _PERCENTILES)
    return float(low), float(high)


# Ten equal bins, the last of which is split where loops are accepted: the tenth would hide what 0.999 means.
BIN_EDGES = (*(k / 10 for k in range(10)), 0.99, 0.999, 1.0)
SURE_PROBABILITY = 0.999


@dataclass(frozen=True)
class Reliability:
    """Reliability table of probabilities.

    Attributes:
        counts: (B,) number of matches with a probability in each bin of BIN_EDGES; a bin holds its lower edge, and
            the last one its upper edge too.
        mean_probabilities: (B,) their mean probability; NaN in an empty bin.
        true_shares: (B,) share of them that is true; NaN in an empty bin.
        sure: number of matches whose probability is at least SURE_PROBABILITY.
        sure_false: number of false ones among these.
    """

    counts: NDArray[np.int64]
    mean_probabilities: Array
    true_shares: Array
    sure: int
    sure_false: int

    @property
    def expected_calibration_error(self) -> float:
        """Mean difference between probability and share of true matches over the bins, weighted by their counts."""
        error = np.abs(self.mean_probabilities - self.true_shares)
        return float(np.nansum(error * self.counts) / self.counts.sum())


def measure_reliability(beliefs: Sequence[Belief], truth: Truth, tolerance: int = 0) -> Reliability | None:
    """Compare the probabilities of matches with the truth; None where no match has a probability.

    Args:
        beliefs: one belief for each query; accepted or not, each match with a probability counts.
        truth: (N, N) truth matrix, row = query, column = earlier image.
        tolerance: images by which a match may miss a true one, as in `is_correct`.
    """
    stated = [b for b in beliefs if b.match is not None and b.probability is not None]
    if not stated:
        return None
    probabilities = np.array([b.probability for b in stated], np.float64)
    right = is_correct(stated, truth, tolerance)
    bins = np.searchsorted(BIN_EDGES[1:-1], probabilities, side="right")

    def total(values: NDArray[np.generic] | None = None) -> NDArray[np.generic]:
        return np.bincount(bins, values, minlength=len(BIN_EDGES) - 1)

    counts = total().astype(np.int64)
    filled = np.where(counts > 0, counts, np.nan)
    sure = probabilities >= SURE_PROBABILITY
    return Reliability(
        counts, total(probabilities) / filled, total(right) / filled, int(sure.sum()), int((sure & ~right).sum())
    )
