"""Probabilities: what they say against what is true."""

import numpy as np
import pytest

from place_recognition.evaluation.stages import BIN_EDGES, measure_reliability
from place_recognition.recognizer import Belief

IMAGES = 4000
TRUTH = np.zeros((IMAGES, IMAGES), bool)
TRUTH[:, 0] = True
TRUTH = np.tril(TRUTH, -1)


def beliefs(probabilities: np.ndarray, right: np.ndarray) -> list[Belief]:
    return [
        Belief(query, 0 if true else 1, 1.0, accepted=p > 0.5, probability=float(p))
        for query, (p, true) in enumerate(zip(probabilities, right, strict=True), start=2)
    ]


def test_probabilities_that_mean_what_they_say_have_a_small_error():
    rng = np.random.default_rng(0)
    p = rng.random(IMAGES - 2)
    table = measure_reliability(beliefs(p, rng.random(len(p)) < p), TRUTH)
    assert table is not None
    assert table.expected_calibration_error < 0.03
    sure_of_all = measure_reliability(beliefs(np.ones(len(p)), rng.random(len(p)) < 0.7), TRUTH)
    assert sure_of_all is not None
    assert sure_of_all.expected_calibration_error == pytest.approx(0.3, abs=0.03)


def test_the_error_is_the_weighted_mean_over_the_bins():
    p = np.array([0.25, 0.25, 0.25, 0.25, 0.85])
    table = measure_reliability(beliefs(p, np.array([True, False, False, False, False])), TRUTH)
    assert table is not None
    assert table.expected_calibration_error == pytest.approx(0.85 / 5)
    assert table.counts.sum() == 5
    assert np.isnan(table.true_shares).sum() == len(BIN_EDGES) - 3


@pytest.mark.parametrize(("p", "bin_index"), [(0.0, 0), (0.1, 1), (0.9, 9), (0.99, 10), (0.999, 11), (1.0, 11)])
def test_a_bin_holds_its_lower_edge_and_the_last_one_both(p: float, bin_index: int):
    table = measure_reliability(beliefs(np.array([p]), np.array([True])), TRUTH)
    assert table is not None
    assert np.flatnonzero(table.counts).tolist() == [bin_index]


def test_the_false_ones_among_the_sure_are_counted():
    p = np.array([0.999, 1.0, 0.9989, 0.9995])
    table = measure_reliability(beliefs(p, np.array([False, True, False, True])), TRUTH)
    assert table is not None
    assert (table.sure, table.sure_false) == (3, 1)


def test_a_match_for_an_image_that_is_no_revisit_is_false():
    truth = TRUTH.copy()
    truth[7] = False
    table = measure_reliability([Belief(7, 0, 1.0, True, probability=1.0)], truth, tolerance=10)
    assert table is not None
    assert table.sure_false == 1


def test_only_matches_with_a_probability_count():
    silent = [Belief(7, 0, 1.0, True), Belief(8, None, 0.0, False, probability=0.2)]
    assert measure_reliability(silent, TRUTH) is None
    table = measure_reliability([*silent, Belief(9, 1, 1.0, False, probability=0.4)], TRUTH)
    assert table is not None
    assert table.counts.sum() == 1
