"""The two-state filter agrees with sums done by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from place_recognition.belief.bayes_filter import BayesFilter, BayesFilterConfig


def probabilities(detections, config=None):
    bayes = BayesFilter(config)
    return [bayes.update(detected) for detected in detections]


def test_the_probability_fades_as_computed_by_hand():
    detections = [True, False, False, False, False]
    assert probabilities(detections) == pytest.approx([1, 0.947, 0.850, 0.696, 0.501], abs=5e-4)


def test_the_likelier_state_is_named():
    bayes, states = BayesFilter(), []
    for detected in (False, True, False, False, False, False, False):
        bayes.update(detected)
        states.append(bayes.is_revisit)
    assert states == [False, True, True, True, True, True, False]


def test_without_detections_the_place_is_new():
    assert BayesFilter().probability == 0
    assert max(probabilities([False] * 100)) < 0.03


def test_with_false_alarms_one_detection_settles_nothing():
    config = BayesFilterConfig(persistence_probability=0.9, false_alarm_probability=0.2, detection_probability=0.8)
    first, second = probabilities([True, True], config)
    assert first == pytest.approx(0.1 * 0.8 / (0.1 * 0.8 + 0.9 * 0.2))
    known = 0.9 * first + 0.1 * (1 - first)
    assert second == pytest.approx(known * 0.8 / (known * 0.8 + (1 - known) * 0.2))


def test_an_impossible_observation_changes_nothing():
    never = BayesFilterConfig(persistence_probability=1.0, false_alarm_probability=0.0)
    assert probabilities([True, True], never) == [0, 0]


@pytest.mark.parametrize("name", ["persistence_probability", "false_alarm_probability", "detection_probability"])
@pytest.mark.parametrize("value", [-0.1, 1.5, float("nan")])
def test_a_number_that_is_no_probability_is_refused(name, value):
    with pytest.raises(ValueError, match=f"expected {name} between 0 and 1, got {value}"):
        BayesFilterConfig(**{name: value})


@settings(max_examples=80, deadline=None)
@given(
    st.lists(st.booleans(), min_size=1, max_size=7),
    st.tuples(st.floats(0.05, 0.95), st.floats(0.05, 0.95), st.floats(0.05, 0.95)),
)
def test_the_filter_agrees_with_a_sum_over_all_histories(detections, numbers):
    config = BayesFilterConfig(*numbers)
    emission = np.array(
        [
            [1 - config.false_alarm_probability, config.false_alarm_probability],
            [1 - config.detection_probability, config.detection_probability],
        ]
    )
    weight = np.zeros(2)
    for history in np.ndindex(*[2] * len(detections)):
        w, before = 1.0, 0  # the way is new before the first image
        for state, detected in zip(history, detections, strict=True):
            stays = config.persistence_probability
            w *= (stays if state == before else 1 - stays) * emission[state, int(detected)]
            before = state
        weight[before] += w
    assert probabilities(detections, config)[-1] == pytest.approx(weight[1] / weight.sum())


@settings(max_examples=80, deadline=None)
@given(
    st.lists(st.booleans(), max_size=30),
    st.tuples(st.floats(0.5, 1), st.floats(0, 0.5), st.floats(0.5, 1)),
)
def test_the_probability_stays_one_and_a_detection_raises_it_above_its_absence(detections, numbers):
    config = BayesFilterConfig(*numbers)
    detected, missed = BayesFilter(config), BayesFilter(config)
    for one in detections:
        assert detected.update(one) == missed.update(one)
        assert 0 <= detected.probability <= 1
    if numbers[1] < numbers[2]:
        assert detected.update(True) >= missed.update(False) - 1e-12
