"""What luck explains: how near false loops come by chance, and how many of the kept ones that may be."""

import numpy as np
import pytest

from slam.robust_chance import discoveries, expected, false_ones


def test_false_loops_fill_the_space_of_errors_evenly() -> None:
    rng = np.random.default_rng(0)
    found = []
    for _ in range(200):
        errors = rng.uniform(-20.0, 20.0, size=(300, 3))
        volume = np.linalg.norm(errors, axis=1) ** 3
        found.append(expected(np.array([4.0**3]), volume)[0])
    inside = 300 * 4.0 / 3.0 * np.pi * 4.0**3 / 40.0**3
    assert np.median(found) == pytest.approx(inside, rel=0.25)


def test_without_a_loop_left_out_nothing_is_luck() -> None:
    np.testing.assert_array_equal(expected(np.array([1.0, 50.0]), np.zeros(0)), 0.0)


def test_the_chance_of_all_errors_grows_alike_with_their_scale() -> None:
    volume, false = np.array([1.0, 7.0]), np.array([30.0, 90.0, 40.0, 55.0])
    np.testing.assert_allclose(expected(16 * volume, 16 * false), expected(volume, false))


def test_where_many_are_kept_the_nearest_left_out_may_be_true() -> None:
    volume, kept = np.arange(120.0), np.arange(120) < 100
    np.testing.assert_array_equal(false_ones(volume, kept), np.arange(102.0, 120.0))
    np.testing.assert_array_equal(false_ones(volume, ~kept), np.arange(100.0))


def test_a_doubtful_loop_passes_in_good_company_only() -> None:
    assert not discoveries(np.array([0.13]), 0.05).any()
    assert discoveries(np.array([0.13, 1e-4, 1e-5]), 0.05).all()
    np.testing.assert_array_equal(discoveries(np.array([0.3, 1e-4, 1e-5]), 0.05), [False, True, True])
