"""Results of earlier images support a new one where they agree, and predict where the next match is."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from place_recognition.belief.candidate_verification import VerificationResult
from place_recognition.belief.temporal_consistency import ConsistencyConfig, TemporalConsistency


def result(query: int, location: int, evidence: float = 30.0, verified: bool = True) -> VerificationResult:
    return VerificationResult(query, location, 40, evidence, verified)


def after(results: list[VerificationResult], config: ConsistencyConfig | None = None) -> TemporalConsistency:
    consistency = TemporalConsistency(config)
    for one in results:
        consistency.add(one)
    return consistency


def test_nothing_is_predicted_before_the_first_match():
    assert TemporalConsistency().predict_locations(100) == []
    assert after([result(99, 20, verified=False)]).predict_locations(100) == []


def test_a_revisit_in_the_same_direction_is_predicted_one_image_further():
    consistency = after([result(100, 20), result(101, 21)], ConsistencyConfig(search_radius=1))
    assert consistency.predict_locations(102) == [22, 21, 23]


def test_a_revisit_in_the_opposite_direction_is_predicted_one_image_back():
    consistency = after([result(100, 21), result(101, 20, 40.0)], ConsistencyConfig(search_radius=1))
    assert consistency.predict_locations(102) == [19, 18, 20]


def test_the_prediction_starts_at_the_match_of_the_most_evidence():
    consistency = after([result(100, 20, 50.0), result(101, 300, 5.0)], ConsistencyConfig(search_radius=0))
    assert consistency.predict_locations(102) == [22]


def test_old_results_neither_predict_nor_support():
    consistency = after([result(100, 20)], ConsistencyConfig(history_images=10))
    assert consistency.predict_locations(110)[0] == 30
    assert consistency.predict_locations(111) == []
    assert consistency.sum_agreeing_evidence(result(110, 30)) == 30.0
    assert consistency.sum_agreeing_evidence(result(111, 31)) == 0.0


@pytest.mark.parametrize(("location", "supports"), [(20, True), (25, True), (26, False), (15, True), (14, False)])
def test_a_result_within_the_speed_and_the_tolerance_supports(location, supports):
    consistency = after([result(100, 20)], ConsistencyConfig(max_speed_ratio=3.0, tolerance_images=2))
    assert consistency.sum_agreeing_evidence(result(101, location)) == (30.0 if supports else 0.0)


def test_agreeing_evidence_makes_a_place_certain():
    config = ConsistencyConfig(certain_evidence=60.0)
    assert not after([result(100, 20)], config).is_certain(result(101, 21))
    assert after([result(100, 20), result(101, 21)], config).is_certain(result(102, 22))
    assert not after([result(100, 20), result(101, 21)], config).is_certain(result(102, 300))


@given(st.lists(st.tuples(st.integers(0, 50), st.floats(0, 100)), max_size=9), st.integers(0, 50), st.floats(0, 100))
def test_one_more_result_never_lowers_the_agreeing_evidence(earlier, location, evidence):
    results = [result(100 + k, at, value) for k, (at, value) in enumerate(earlier)]
    query = result(100 + len(earlier) + 1, 25)
    more = [*results, result(100 + len(earlier), location, evidence)]
    less_sum, more_sum = (after(some).sum_agreeing_evidence(query) for some in (results, more))
    assert more_sum >= less_sum - 1e-9
    assert more_sum <= sum(one.evidence for one in more) + 1e-9


@given(st.integers(0, 20))
def test_predictions_are_distinct_and_nearest_first(radius):
    locations = after([result(100, 50)], ConsistencyConfig(search_radius=radius)).predict_locations(101)
    assert sorted(locations) == list(range(51 - radius, 52 + radius))
    distances = [abs(location - 51) for location in locations]
    assert distances == sorted(distances)
