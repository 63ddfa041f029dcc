"""More evidence never speaks against a place, and the tables say so."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from place_recognition.belief.likelihood_ratios import GEOMETRY, OWN_SCORES, RatioTable, log_ratios, sharpness
from place_recognition.paradigms.registry import PARADIGMS

EVIDENCE = st.lists(st.floats(0, 200), min_size=1, max_size=6)
TABLES = {"geometry": GEOMETRY, **OWN_SCORES}


@pytest.mark.parametrize("name", TABLES)
def test_knots_rise_and_a_better_score_is_never_less_likely_at_a_revisit(name):
    table = TABLES[name]
    assert len(table.scores) == len(table.log_ratios)
    assert (np.diff(table.scores) > 0).all()
    assert (np.diff(table.log_ratios) >= 0).all()


@pytest.mark.parametrize("name", TABLES)
def test_beyond_its_knots_a_table_is_constant(name):
    table = TABLES[name]
    ends = table([table.scores[0] - 1000, table.scores[-1] + 1000])
    assert ends.tolist() == [table.log_ratios[0], table.log_ratios[-1]]


def test_a_table_is_straight_between_its_knots():
    table = RatioTable((0, 10), (-1, 3))
    np.testing.assert_allclose(table([0, 2.5, 10]), [-1, 0, 3])


def test_each_paradigm_has_a_table_and_the_control_learns_nothing_from_its_score():
    assert OWN_SCORES.keys() == {*PARADIGMS, "random-images"}
    assert OWN_SCORES["random-images"]([-5.0, 0.0, 5.0]).tolist() == [0, 0, 0]


def test_geometry_without_agreement_speaks_against_a_place_and_strong_agreement_for_it():
    assert log_ratios(np.zeros(1), np.zeros(1))[0] < -1
    assert log_ratios(np.zeros(1), np.array([100.0]))[0] > 2


@given(EVIDENCE, st.integers(0, 5), st.floats(0, 50), st.floats(-3, 3))
def test_more_evidence_or_a_better_score_never_lowers_the_ratio_of_a_candidate(evidence, index, more, own):
    k, values, scores = index % len(evidence), np.array(evidence), np.full(len(evidence), own)
    better, likelier = values.copy(), scores.copy()
    better[k] += more
    likelier[k] += more
    before = log_ratios(scores, values)
    assert log_ratios(scores, better)[k] >= before[k] - 1e-12
    assert log_ratios(likelier, values)[k] >= before[k] - 1e-12
    others = np.arange(len(values)) != k
    assert (log_ratios(scores, better)[others] <= before[others] + 1e-12).all()  # and never helps another one


@given(EVIDENCE)
def test_the_candidate_of_most_evidence_is_the_likeliest_and_alone_as_likely(evidence):
    values = np.array(evidence)
    best = int(values.argmax())
    ratios = log_ratios(np.zeros(len(values)), values)
    assert ratios[best] == ratios.max()
    assert ratios[best] == pytest.approx(log_ratios(np.zeros(1), values[best : best + 1])[0])


def test_without_candidates_there_are_no_ratios():
    assert log_ratios(np.empty(0), np.empty(0)).shape == (0,)


@given(EVIDENCE)
def test_a_place_is_known_no_worse_than_usual_and_better_with_more_evidence(evidence):
    values = np.sort(evidence)
    sharp = sharpness(values)
    assert sharpness(np.zeros(1))[0] == 1.0
    assert (sharp >= 1.0).all()
    assert (np.diff(sharp) >= 0).all()
