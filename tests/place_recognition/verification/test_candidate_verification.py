"""Geometric verification: oriented, scored against chance, the same for the same seed."""

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from landmark_street import HEIGHT_PX, WIDTH_PX, LandmarkStreet, history_of, unrelated_features
from scipy.special import gammaln

from place_recognition.belief.decisions import min_evidence
from place_recognition.verification import candidate_verification
from place_recognition.verification.candidate_verification import (
    CandidateVerificationConfig,
    EpipolarConfig,
    a_contrario_evidence,
    epipolar_inliers,
    keeps_orientation,
    verify_candidates,
    verify_pair,
)

CONFIG = CandidateVerificationConfig()
POOL = ThreadPoolExecutor(2)


@pytest.fixture(scope="module")
def images():
    """Forty images along a street, then the same stretch from 0.4 m beside it, then mirrored."""
    street = LandmarkStreet(seed=3)
    first = [street.view(2.0 * k) for k in range(40)]
    second = [street.view(2.0 * k, x_m=0.4) for k in range(40)]
    mirrored = [street.view(2.0 * k, mirrored=True) for k in range(40)]
    return history_of([view.features for view in first + second + mirrored]).images


def test_the_true_pair_has_much_evidence_and_another_place_none(images):
    for k in (5, 20, 35):
        assert verify_pair(images, 40 + k, k, CONFIG).evidence > 40
        assert verify_pair(images, 40 + k, (k + 20) % 40, CONFIG).evidence < 2


def test_a_mirrored_street_is_no_evidence_although_a_fundamental_matrix_fits(images, monkeypatch):
    results = [verify_pair(images, 80 + k, k, CONFIG) for k in range(40)]
    assert all(result.evidence == 0 and result.inliers == 0 and len(result.pixels) == 0 for result in results)
    monkeypatch.setattr(candidate_verification, "keeps_orientation", lambda pixels: True)
    assert np.median([verify_pair(images, 80 + k, k, CONFIG).evidence for k in range(40)]) > 40


def test_orientation_is_kept_by_a_turn_and_a_step_and_not_by_a_mirror():
    rng = np.random.default_rng(1)
    points = rng.uniform([-6, -3, 6], [6, 3, 30], (60, 3))
    for angle in np.radians([-20, 0, 20]):
        turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
        moved = points @ turn.T + [0.5, 0.0, -1.0]
        first, second = (400 * p[:, :2] / p[:, 2:] for p in (points, moved))
        assert keeps_orientation(np.concatenate([first, second], axis=1).astype(np.float32))
        mirrored = np.concatenate([first, second * [-1, 1]], axis=1)
        assert not keeps_orientation(mirrored.astype(np.float32))


def test_the_evidence_is_the_published_number_of_false_alarms():
    """Moisan and Stival, equation 15, in exact integers: 3 (n - 7) C(n, k) C(k, 7) p^(k - 7)."""
    n, k, p = 60, 40, 0.02
    expected = 3 * (n - 7) * math.comb(n, k) * math.comb(k, 7) * p ** (k - 7)
    assert a_contrario_evidence(k, n, p) == pytest.approx(-math.log10(expected))


@given(st.integers(8, 300), st.integers(0, 300), st.floats(1e-4, 0.3))
def test_the_evidence_is_the_sum_of_logarithms_that_scipy_gives(inliers, outliers, p):
    n, k = inliers + outliers, inliers
    choose_k = gammaln(n + 1) - gammaln(k + 1) - gammaln(n - k + 1)
    choose_7 = gammaln(k + 1) - gammaln(8) - gammaln(k - 6)
    log_nfa = np.log(3 * (n - 7)) + choose_k + choose_7 + (k - 7) * np.log(p)
    assert a_contrario_evidence(k, n, p) == pytest.approx(max(-log_nfa / np.log(10), 0.0), abs=1e-7)


@given(st.integers(8, 300), st.integers(0, 200), st.floats(1e-4, 0.3))
def test_evidence_is_never_negative_and_grows_with_the_inliers(inliers, outliers, p):
    matches = inliers + outliers
    evidence = [a_contrario_evidence(k, matches, p) for k in range(inliers, matches + 1)]
    assert min(evidence) >= 0.0
    positive = [value for value in evidence if value > 0]
    assert positive == sorted(positive)


@given(st.integers(20, 100), st.integers(0, 100), st.integers(1, 100), st.floats(1e-4, 0.3))
def test_evidence_falls_with_the_outliers_and_with_chance(inliers, outliers, more, p):
    evidence = a_contrario_evidence(inliers, inliers + outliers, p)
    assert a_contrario_evidence(inliers, inliers + outliers + more, p) <= evidence
    assert a_contrario_evidence(inliers, inliers + outliers, min(1.5 * p, 0.5)) <= evidence


@pytest.mark.parametrize("inliers", [0, 5, 7])
def test_a_minimal_sample_is_no_evidence(inliers):
    assert a_contrario_evidence(inliers, 50, 0.01) == 0.0


def random_evidence(count: int, tries: int, seed: int = 0) -> np.ndarray:
    """Evidence of as many random matches each time, found as for a pair of images."""
    rng, found = np.random.default_rng(seed), []
    p = 2 * CONFIG.epipolar.max_distance_px * math.hypot(WIDTH_PX, HEIGHT_PX) / (WIDTH_PX * HEIGHT_PX)
    for _ in range(tries):
        first, second = (rng.uniform(0, 1, (2, count, 2)) * [WIDTH_PX, HEIGHT_PX]).astype(np.float32)
        mask = epipolar_inliers(first, second, CONFIG.epipolar)
        found.append(0.0 if mask is None else a_contrario_evidence(int(mask.sum()), count, p))
    return np.array(found)


def test_random_matches_have_evidence_no_more_often_than_the_number_of_false_alarms_allows():
    """Evidence e stands for 10^-e chance agreements: of 250 random pairs at most 25 + noise may have more than 1."""
    evidence = np.concatenate([random_evidence(count, 125) for count in (20, 60)])
    assert np.mean(evidence > 1) <= 0.1
    assert np.mean(evidence > 2) <= 0.02
    assert evidence.max() < 3.5


def test_unrelated_images_are_never_verified_in_a_drive():
    rng = np.random.default_rng(5)
    images = history_of([unrelated_features(rng) for _ in range(60)]).images
    pairs = [(query, location) for query in range(1, 60) for location in range(0, query, 12)]
    evidence = [verify_pair(images, *pair, CONFIG).evidence for pair in pairs]
    assert not any(e >= min_evidence(pair[0], CONFIG) for e, pair in zip(evidence, pairs, strict=True))


@given(st.integers(0, 10**6), st.integers(1, 20))
def test_a_verified_pair_is_less_than_one_chance_match_in_the_drive(query, candidates):
    config = CandidateVerificationConfig(max_candidates=candidates)
    tests_so_far = candidates * (query + 1)
    assert tests_so_far * 10 ** -min_evidence(query, config) == pytest.approx(1.0)


def noisy_matches(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Matches of which few agree, so that the drawn samples matter."""
    rng = np.random.default_rng(seed)
    first, second = (rng.uniform(0, 1, (2, 120, 2)) * [WIDTH_PX, HEIGHT_PX]).astype(np.float32)
    second[:20] = first[:20] + rng.normal(0, 2, (20, 2)) + np.array([30, 0])
    return first, second


def test_the_seed_reaches_the_samples_and_the_same_seed_gives_the_same_inliers():
    def masks(seed: int) -> list[bytes]:
        config = EpipolarConfig(seed=seed, min_inliers=7)
        found = [epipolar_inliers(*noisy_matches(k), config) for k in range(12)]
        return [b"" if mask is None else mask.tobytes() for mask in found]

    assert masks(1) == masks(1)
    assert masks(1) != masks(2)


def test_candidates_are_verified_in_order_until_one_has_enough_evidence(images):
    results = verify_candidates(images, 60, [3, 20, 7], 40, CONFIG, POOL)
    assert [result.location for result in results][:2] == [3, 20]
    assert 7 not in [result.location for result in results]
    impatient = CandidateVerificationConfig(early_stop_evidence=1e9, max_candidates=2, refine_radius=0)
    assert [result.location for result in verify_candidates(images, 60, [3, 20, 7], 40, impatient, POOL)] == [3, 20]


def test_the_image_beside_the_best_candidate_that_matches_best_is_verified_too(images):
    results = verify_candidates(images, 60, [22], 40, CONFIG, POOL)
    assert [result.location for result in results] == [22, 20]
    assert results[1].evidence > results[0].evidence


def test_no_image_later_than_the_last_matchable_is_verified(images):
    results = verify_candidates(images, 60, [18], 18, CONFIG, POOL)
    assert max(result.location for result in results) <= 18


def test_without_candidates_there_is_no_result(images):
    assert verify_candidates(images, 60, [], 40, CONFIG, POOL) == ()


def test_the_number_of_threads_changes_no_result(images):
    config = CandidateVerificationConfig(early_stop_evidence=1e9)
    for query in (45, 60, 75):
        one, three = (
            verify_candidates(images, query, [3, query - 40, 7, 30, 12], 40, config, ThreadPoolExecutor(count))
            for count in (1, 3)
        )
        assert one == three
        assert all(np.array_equal(a.pixels, b.pixels) for a, b in zip(one, three, strict=True))
