"""Revisit events: stretches of the recording in which the camera is where it has been, and when each was recognised."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from place_recognition.evaluation.precision_recall import is_correct
from place_recognition.recognizer import Belief

Truth = NDArray[np.bool_]

# Images without truth that do not end an event: a second at ten images a second. The holes in the published matrices
# have 1 to 6 images, what lies between two revisits has 13, and mostly 31 or more.
MAX_GAP_IMAGES = 10


@dataclass(frozen=True)
class RevisitEvent:
    """A stretch of queries with truth, and its first detection.

    Attributes:
        first, last: ids of its first and last query with truth.
        detected: id of its first query with an accepted true match; None where there is none.
        answered_at: id of the latest image when the first accepted true match of the event became known, which may be
            that of a later query; None where there is none, or where the beliefs do not say.
    """

    first: int
    last: int
    detected: int | None = None
    answered_at: int | None = None


def find_revisit_events(beliefs: Sequence[Belief], truth: Truth, tolerance: int = 0) -> tuple[RevisitEvent, ...]:
    """Find the revisit events of a recording, and what was recognised of each.

    Args:
        beliefs: one belief for each query.
        truth: (N, N) truth matrix, row = query, column = earlier image. Queries with truth that are at most
            MAX_GAP_IMAGES images without truth apart belong to one event.
        tolerance: images by which a match may miss a true one, as in `is_correct`.
    """
    right = is_correct(beliefs, truth, tolerance)
    detections = sorted((b.query, b.answered_at) for b, r in zip(beliefs, right, strict=True) if r and b.accepted)
    return tuple(_describe(first, last, detections) for first, last in _stretches(truth))


def answer_delays(beliefs: Sequence[Belief]) -> NDArray[np.int64]:
    """Return (K, 2) query and latest image when its belief became ready, of the beliefs that say so."""
    known = [(b.query, b.answered_at) for b in beliefs if b.answered_at is not None]
    return np.array(known, np.int64).reshape(-1, 2)


def _stretches(truth: Truth) -> list[tuple[int, int]]:
    queries = np.flatnonzero(truth.any(axis=1))
    ends = np.flatnonzero(np.diff(queries) > MAX_GAP_IMAGES + 1)
    firsts, lasts = queries[np.append(0, ends + 1)[: len(queries)]], queries[np.append(ends, -1)[: len(queries)]]
    return list(zip(firsts.tolist(), lasts.tolist(), strict=True))


def _describe(first: int, last: int, detections: list[tuple[int, int | None]]) -> RevisitEvent:
    inside = [(query, ready) for query, ready in detections if first <= query <= last]
    ready_at = [ready for _, ready in inside if ready is not None]
    return RevisitEvent(first, last, inside[0][0] if inside else None, min(ready_at, default=None))
