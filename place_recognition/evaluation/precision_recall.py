"""Precision and recall of recognised places over all thresholds of the score.

Precision = TP / (TP + FP), recall = TP / (queries that have a true match). A query has one detection at most: its
belief's match, if it was verified or has a probability. A detection for a query without a true match is false; a query
with neither counts for nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from place_recognition.recognizer import Belief

Array = NDArray[np.float64]
Images = NDArray[np.int64]


class Truth(Protocol):
    """Truth matrix (N, M) bool, row = query, column = earlier image or image of a reference recording.

    An array, or what computes its cells where they are asked for.
    """

    @property
    def shape(self) -> tuple[int, ...]:
        """(N, M)."""
        ...

    def __len__(self) -> int: ...

    def __getitem__(self, cells: tuple[Images, Images], /) -> Any:
        """Cells (K,) of rows (K,) and columns (K,)."""
        ...

    def any(self, axis: int | None = None) -> Any:
        """Whether there is any true cell: in all, or in each row (N,) with axis 1."""
        ...


@dataclass(frozen=True)
class PrecisionRecall:
    """A precision-recall curve and its summary.

    Attributes:
        thresholds: (K,) distinct scores, falling; all detections of a score of at least this count.
        precision, recall: (K,) precision and recall at each threshold.
        true_positives, false_positives: (K,) int64 number of detections at each threshold.
        truth_rows: number of queries that have a true match.
    """

    thresholds: Array
    precision: Array
    recall: Array
    true_positives: NDArray[np.int64]
    false_positives: NDArray[np.int64]
    truth_rows: int

    @property
    def recall_at_full_precision(self) -> float:
        """R@P100: the greatest recall without a false detection; 0 if the detection of the highest score is false."""
        clean = self._clean
        return 0.0 if clean is None else float(self.recall[clean])

    @property
    def threshold_at_full_precision(self) -> float | None:
        """The lowest score without a false detection at or above it; None if there is none."""
        clean = self._clean
        return None if clean is None else float(self.thresholds[clean])

    @property
    def average_precision(self) -> float:
        """Precision at each threshold, weighted by the recall gained there."""
        return float(np.sum(self.precision * np.diff(self.recall, prepend=0.0)))

    @property
    def area_under_curve(self) -> float:
        """Area under straight lines between the points; precision from recall 0 to the first point is that point's."""
        before = np.concatenate([self.precision[:1], self.precision[:-1]])
        return float(np.sum((before + self.precision) / 2 * np.diff(self.recall, prepend=0.0)))

    @property
    def _clean(self) -> int | None:
        clean = np.flatnonzero(self.false_positives == 0)
        return int(clean[-1]) if len(clean) else None


def is_correct(beliefs: Sequence[Belief], truth: Truth, tolerance: int = 0) -> NDArray[np.bool_]:
    """Decide whether the match of each belief (B,) is true; False without a match.

    Args:
        beliefs: beliefs whose query and match index the truth.
        truth: (N, M) truth matrix, row = query, column = earlier image, or image of a reference recording.
        tolerance: number of columns by which a match may differ from a true one. 0 is the rule of the chapter's
            authors, whose tolerance is in the matrix; 10 reproduces iBoW-LCD's published figures.
    """
    for belief in beliefs:
        _check_query(belief, truth.shape)
    queries = np.array([belief.query for belief in beliefs], np.int64)
    matches = np.array([-1 if belief.match is None else belief.match for belief in beliefs], np.int64)
    right = np.zeros(len(beliefs), np.bool_)
    for offset in range(-tolerance, tolerance + 1):
        columns = matches + offset
        asked = np.flatnonzero((matches >= 0) & (columns >= 0) & (columns < truth.shape[1]) & ~right)
        right[asked] = truth[queries[asked], columns[asked]]
    return right


def precision_recall(beliefs: Sequence[Belief], truth: Truth, tolerance: int = 0) -> PrecisionRecall:
    """Compute the curve over all thresholds of the score.

    Args:
        beliefs: one for each query; which of them are detections: `Belief.is_detection`.
        truth: (N, N) truth matrix, row = query, column = earlier image; queries without a belief count as missed.
        tolerance: see `is_correct`.
    """
    right = is_correct(beliefs, truth, tolerance)
    detected = np.array([b.is_detection for b in beliefs], np.bool_)
    scores = np.array([b.score for b in beliefs], np.float64)[detected]
    right = right[detected]
    # No threshold separates equal scores, so they are counted together.
    thresholds = np.unique(scores)[::-1]
    return _curve(scores, right, thresholds, int(truth.any(axis=1).sum()))


def accepted_counts(beliefs: Sequence[Belief], truth: Truth, tolerance: int = 0) -> tuple[int, int]:
    """Count the true and the false ones among the beliefs that the recogniser itself accepted."""
    right = is_correct(beliefs, truth, tolerance)
    accepted = np.array([b.accepted for b in beliefs], np.bool_)
    return int((accepted & right).sum()), int((accepted & ~right).sum())


def _curve(scores: Array, right: NDArray[np.bool_], thresholds: Array, truth_rows: int) -> PrecisionRecall:
    order = np.argsort(-scores, kind="stable")
    until = np.searchsorted(-scores[order], -thresholds, side="right")
    hits = np.concatenate([[0], np.cumsum(right[order])]).astype(np.int64)[until]
    return PrecisionRecall(
        thresholds=thresholds,
        precision=hits / np.maximum(until, 1),
        recall=hits / max(truth_rows, 1),
        true_positives=hits,
        false_positives=(until - hits).astype(np.int64),
        truth_rows=truth_rows,
    )


def leave_out_tolerated(beliefs: Sequence[Belief], tolerated: NDArray[np.bool_] | None) -> list[Belief]:
    """Return the beliefs without the images that are neither right nor wrong.

    As Schubert, Neubert, Garg, Milford, Fischer, 'Visual Place Recognition: A Tutorial', IEEE Robotics and Automation
    Magazine 31(3) 2024, have it, these are no answers: not true, not false, and no candidates.

    Args:
        beliefs: beliefs whose query and match index the matrix.
        tolerated: (N, M) bool, row = query; None where every answer is right or wrong.
    """
    if tolerated is None:
        return list(beliefs)
    counted = ~tolerated
    return [belief.keep_images(counted[belief.query].item) for belief in beliefs]


def _check_query(belief: Belief, shape: tuple[int, ...]) -> None:
    rows, columns = shape
    if not 0 <= belief.query < rows or (belief.match is not None and not 0 <= belief.match < columns):
        below = rows if rows == columns else f"{rows} and {columns}"
        raise ValueError(f"expected query and earlier match below {below}, got {belief.query} and {belief.match}")
