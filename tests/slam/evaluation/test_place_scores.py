"""The section `places` of metrics.json agrees with counts by hand, and gives a reason for each missing value."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from place_recognition.evaluation.memory import MapSize
from place_recognition.recognizer import Belief
from slam.evaluation.place_metrics import evaluate_places, measure_scores


def beliefs_of(matches: list[int | None], scores: list[float]) -> list[Belief]:
    """A belief for each query 0, 1, ..., accepted where it has a match."""
    return [
        Belief(k, match, score if match is not None else 0.0, accepted=match is not None)
        for k, (match, score) in enumerate(zip(matches, scores, strict=True))
    ]


def revisit_truth(size: int, lag: int) -> np.ndarray:
    """Truth (N, N) of a second lap that begins after `lag` images."""
    return np.eye(size, k=-lag, dtype=bool)


def test_scores_of_a_short_run_agree_with_counts_by_hand():
    # Queries 3 to 5 are revisits of 0 to 2. Two matches are right, that of the lowest score is wrong.
    beliefs = beliefs_of([None, None, None, 0, 1, 0], [0, 0, 0, 9.0, 8.0, 7.0])
    section = evaluate_places("tracked-words", beliefs, revisit_truth(6, 3), MapSize(words=12, bytes=34)).section
    assert (section["true_positives"], section["false_positives"], section["truth_rows"]) == (2, 1, 3)
    assert section["recall_at_100_precision"] == pytest.approx(2 / 3)
    assert section["threshold_at_100_precision"] == 8.0
    assert (section["words"], section["map_bytes"], section["queries"]) == (12, 34, 6)


def test_a_tolerance_takes_near_matches_for_true():
    beliefs = beliefs_of([None] * 20 + [1, 5], [0.0] * 20 + [9.0, 8.0])
    truth = revisit_truth(22, 20)
    assert measure_scores(beliefs, truth, 0)["true_positives"] == 0
    assert measure_scores(beliefs, truth, 1)["true_positives"] == 1
    assert measure_scores(beliefs, truth, 4)["true_positives"] == 2


def nulls(name, value):
    """Dotted names of all nulls in nested sections."""
    if isinstance(value, dict):
        return [found for key, inner in value.items() for found in nulls(f"{name}.{key}", inner)]
    return [name] if value is None else []


@pytest.mark.parametrize(
    ("truth", "reason"),
    [(None, "there is no ground truth"), (np.zeros((2, 2), bool), "no image is a revisit by ground truth")],
)
def test_every_missing_value_has_a_reason(truth, reason):
    result = evaluate_places("pixel-sequences", beliefs_of([None, 0], [0.0, 5.0]), truth)
    assert result.curve is None
    assert set(nulls("places", result.section)) - {"places.map_bytes"} == set(result.notes)
    assert result.notes["places.average_precision"] == reason


@given(st.lists(st.tuples(st.none() | st.integers(0, 9), st.floats(0.1, 100)), min_size=20, max_size=20))
def test_recall_and_precision_are_shares_and_grow_with_the_tolerance(rows):
    matches, scores = [None] * 10 + [match for match, _ in rows[10:]], [score for _, score in rows]
    beliefs, truth = beliefs_of(matches, scores), revisit_truth(20, 10)
    results = [measure_scores(beliefs, truth, tolerance) for tolerance in (0, 2, 10)]
    for result in results:
        assert 0.0 <= result["recall_at_100_precision"] <= 1.0
        assert result["true_positives"] + result["false_positives"] == sum(m is not None for m in matches)
    true_positives = [result["true_positives"] for result in results]
    assert true_positives == sorted(true_positives)
