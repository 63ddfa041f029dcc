"""What luck explains: how near false loops come by chance, and how many of the kept ones that may be."""

import numpy as np
import pytest

from slam.pose_graph.robust.likelihood_ratio import benjamini_hochberg, expected_false_positives


def test_one_in_twenty_false_loops_has_evidence_of_twenty_to_one() -> None:
    rng = np.random.default_rng(0)
    nats = rng.exponential(size=(200, 1000))  # one in exp(e) has e nats or more
    found = [expected_false_positives(np.r_[np.log(20.0), each], np.arange(1001) == 0)[0] for each in nats]
    assert np.median(found) <= 3.0  # no more than the best three that set the rate
    sure = [expected_false_positives(np.r_[np.log(20_000.0), each], np.arange(1001) == 0)[0] for each in nats]
    assert np.median(sure) == pytest.approx(1000 / 20_000.0, rel=0.25)


def test_no_loop_is_insignificant_where_none_was_left_out() -> None:
    np.testing.assert_array_equal(expected_false_positives(np.array([1.0, 50.0]), np.ones(2, dtype=bool)), 0.0)
    np.testing.assert_array_equal(expected_false_positives(np.array([1.0, -np.inf]), np.array([True, False])), 0.0)


def test_where_many_are_kept_the_best_of_those_left_out_may_be_true() -> None:
    nats = np.r_[np.full(100, 12.0), 9.0, 9.0, 2.0, 2.0, 2.0]
    np.testing.assert_allclose(expected_false_positives(nats, np.arange(105) < 100)[:100], 3.0 * np.exp(2.0 - 12.0))


def test_a_weak_loop_passes_only_among_strong_ones() -> None:
    assert not benjamini_hochberg(np.array([0.13]), 0.05).any()
    assert benjamini_hochberg(np.array([0.13, 1e-4, 1e-5]), 0.05).all()
    np.testing.assert_array_equal(benjamini_hochberg(np.array([0.3, 1e-4, 1e-5]), 0.05), [False, True, True])
