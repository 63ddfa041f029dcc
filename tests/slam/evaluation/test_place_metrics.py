"""The section `places` of metrics.json: the same keys always, and figures that obey what they measure."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from place_recognition.recognizer import Belief
from slam.evaluation.place_metrics import COMMON_TOLERANCE_IMAGES, evaluate_places, measure_scores

COUNT = 60
TRUTH = np.eye(COUNT, k=-30, dtype=bool)


def beliefs(seed: int, spread: int) -> list[Belief]:
    """A match for each query of the second half, up to `spread` images off, with scores of their own."""
    rng = np.random.default_rng(seed)
    found = []
    for query in range(30, COUNT):
        match = int(np.clip(query - 30 + rng.integers(-spread, spread + 1), 0, query - 1))
        found.append(Belief(query, match, float(rng.random()), bool(rng.random() < 0.7)))
    return found


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000), spread=st.integers(0, 20))
def test_a_tolerance_turns_no_true_match_into_a_false_one(seed: int, spread: int) -> None:
    asked = beliefs(seed, spread)
    exact, tolerant = measure_scores(asked, TRUTH, 0), measure_scores(asked, TRUTH, COMMON_TOLERANCE_IMAGES)
    assert tolerant["true_positives"] >= exact["true_positives"]
    assert tolerant["false_positives"] <= exact["false_positives"]
    accepted = sum(belief.accepted for belief in asked)
    for metrics in (exact, tolerant):
        assert metrics["true_positives"] + metrics["false_positives"] == accepted
        assert 0.0 <= metrics["recall_at_100_precision"] <= 1.0
        assert metrics["truth_rows"] == 30


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000), factor=st.floats(0.5, 100.0), offset=st.floats(-10.0, 10.0))
def test_figures_do_not_depend_on_the_scale_of_the_scores(seed: int, factor: float, offset: float) -> None:
    asked = beliefs(seed, 2)
    other = [Belief(b.query, b.match, factor * b.score + offset, b.accepted) for b in asked]
    for name in ("recall_at_100_precision", "average_precision", "true_positives", "false_positives"):
        assert measure_scores(other, TRUTH, 0)[name] == pytest.approx(measure_scores(asked, TRUTH, 0)[name])


def test_exact_matches_have_full_recall() -> None:
    asked = [Belief(query, query - 30, 1.0 + query, True) for query in range(30, COUNT)]
    metrics = evaluate_places("tracked-words", asked, TRUTH).section
    assert (metrics["recall_at_100_precision"], metrics["average_precision"]) == (1.0, pytest.approx(1.0))
    assert metrics["threshold_at_100_precision"] == 31.0


@pytest.mark.parametrize("truth", [None, np.zeros((COUNT, COUNT), bool)])
def test_without_truth_there_are_the_same_keys_and_a_reason_for_each_null(truth: np.ndarray | None) -> None:
    asked = beliefs(0, 0)
    known, unknown = (evaluate_places("p", asked, matrix) for matrix in (TRUTH, truth))
    assert set(known.section) == set(unknown.section)
    assert unknown.curve is None
    missing = {f"places.{name}" for name, value in unknown.section.items() if value is None}
    assert missing - set(unknown.notes) <= {"places.map_bytes"}
    assert known.curve is not None


def test_where_the_best_detection_is_false_there_is_no_threshold_but_a_reason() -> None:
    result = evaluate_places("p", [Belief(40, 3, 9.0, True), Belief(41, 11, 1.0, True)], TRUTH)
    assert result.section["threshold_at_100_precision"] is None
    assert "highest score is false" in result.notes["places.threshold_at_100_precision"]
