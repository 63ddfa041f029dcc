"""The best candidates are verified, and the evidence of their inliers follows the a-contrario formula."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from place_images import sliding_view, textured_world

from place_recognition.belief.candidate_selection import CandidateVerifier
from place_recognition.belief.candidate_verification import (
    CandidateVerificationConfig,
    a_contrario_evidence,
    count_surplus_inliers,
    match_images,
    rank_candidates,
)
from place_recognition.belief.temporal_consistency import ConsistencyConfig
from place_recognition.image_processing.surf import Surf
from place_recognition.map.feature_store import FeatureStore


@pytest.fixture(scope="module")
def store():
    """Twenty images past ever new things, and the same again."""
    images = FeatureStore(300)
    lap = sliding_view(textured_world(900, seed=5), list(range(0, 580, 29)))
    for image in lap + lap:
        images.add(Surf().extract(image))
    return images


def test_an_object_counts_as_a_minimal_sample_and_no_more():
    rng = np.random.default_rng(0)
    car = rng.uniform([100, 100], [160, 160], (60, 2)).astype(np.float32)
    street = np.stack([np.arange(0, 1200, 100), np.full(12, 50)], axis=1).astype(np.float32)
    assert count_surplus_inliers(car, 60.0) == 60 - 7
    assert count_surplus_inliers(street, 60.0) == 0
    assert count_surplus_inliers(np.concatenate([car, street + np.float32([300, 0])]), 60.0) == 60 - 7
    assert count_surplus_inliers(np.concatenate([car, car + np.float32([500, 0])]), 60.0) == 2 * (60 - 7)


def verifier(store: FeatureStore, max_verified: int = 4) -> CandidateVerifier:
    return CandidateVerifier(store, CandidateVerificationConfig(max_verified=max_verified), ConsistencyConfig())


def test_candidates_are_verified_in_the_order_of_their_rank_until_one_has_enough_evidence(store):
    config = CandidateVerificationConfig(max_verified=3)
    results = verifier(store, 3).verify(28, [3, 7, 8], 10)
    ranked = rank_candidates(store, 28, [3, 7, 8], config)
    expected = [match_images(store, 28, location, config).verify(config.epipolar) for location in ranked]
    assert results == tuple(expected)[: len(results)]
    assert max(results, key=lambda result: result.evidence).location == 8
    assert all(result.evidence < config.early_stop_evidence for result in results[:-1])


def test_candidates_are_ranked_by_matches_and_cut_off(store):
    config = CandidateVerificationConfig(max_verified=2)
    assert rank_candidates(store, 28, [3, 9, 8, 2], config) == [8, 9]
    assert rank_candidates(store, 28, [], config) == []


def test_the_same_view_has_much_evidence_and_another_little(store):
    assert verifier(store).verify(28, [8], 10)[0].evidence > 40
    assert verifier(store).verify(39, [0], 3)[0].evidence < 5


def test_a_match_that_moves_on_needs_no_proposal(store):
    one = verifier(store)
    one.verify(25, [5], 15)
    assert [result.location for result in one.verify(26, [], 15)] == [6]


def verified_after_falling_behind(certain_evidence: float) -> list[int]:
    """Locations that are verified when the second lap falls two images behind the prediction."""
    images, lap = FeatureStore(300), sliding_view(textured_world(900, seed=5), list(range(0, 580, 29)))
    for image in [*lap, *lap[:10], lap[8]]:
        images.add(Surf().extract(image))
    verification = CandidateVerificationConfig(early_stop_evidence=1000.0)
    one = CandidateVerifier(images, verification, ConsistencyConfig(search_radius=0, certain_evidence=certain_evidence))
    for query in range(20, 30):
        one.verify(query, [query - 20], 15)
    return [result.location for result in one.verify(30, [], 15)]


def test_where_the_place_is_certain_neighbours_of_more_evidence_are_found():
    assert verified_after_falling_behind(certain_evidence=200.0) == [10, 9, 11, 8, 7]
    assert verified_after_falling_behind(certain_evidence=1e9) == [10]


def test_elsewhere_neighbours_are_not_verified(store):
    one = CandidateVerifier(store, CandidateVerificationConfig(early_stop_evidence=1000.0), ConsistencyConfig())
    assert [result.location for result in one.verify(28, [7], 15)] == [7]


def test_without_candidates_there_is_no_result(store):
    assert verifier(store).verify(25, [], 15) == ()


def test_the_evidence_is_the_published_number_of_false_alarms():
    """Moisan and Stival, equation 15, in exact integers: 3 (n - 7) C(n, k) C(k, 7) p^(k - 7)."""
    n, k, p = 60, 40, 0.02
    expected = 3 * (n - 7) * math.comb(n, k) * math.comb(k, 7) * p ** (k - 7)
    assert a_contrario_evidence(k, n, p) == pytest.approx(-math.log10(expected))


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


@given(st.integers(0, 2**32 - 1), st.integers(0, 80), st.floats(0.0, 500.0))
def test_the_surplus_leaves_a_minimal_sample_of_each_object_and_all_of_scattered_inliers(seed, count, radius):
    pixels = np.random.default_rng(seed).uniform(0, 1000, (count, 2)).astype(np.float32)
    surplus = count_surplus_inliers(pixels, radius)
    assert 0 <= surplus <= max(count - 7, 0)
    assert count_surplus_inliers(pixels, 0.0) == 0
    assert count_surplus_inliers(pixels, 2000.0) == max(count - 7, 0)
