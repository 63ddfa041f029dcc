"""Every stage is measured by its own match and score, and intervals come from blocks of neighbouring queries."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from place_recognition.evaluation.precision_recall import precision_recall
from place_recognition.evaluation.stages import (
    CURVE_SUMMARIES,
    MAX_BLOCK_IMAGES,
    candidate_ranks,
    curve_intervals,
    measure_stages,
    sample_weights,
    stage_answers,
    stage_intervals,
)
from place_recognition.recognizer import Belief, StageScores

LAP = 40
TRUTH = np.eye(2 * LAP, k=-LAP) > 0


def belief(query, match, score, *candidates, own=1.0, geometry=None, evidence=None):
    """A belief whose later stages may each name another image."""
    stages = StageScores(candidates, own if candidates else None, geometry, evidence)
    return Belief(query, match, score, accepted=score > 5, stages=stages)


def test_each_stage_is_measured_by_its_own_match_and_score():
    beliefs = [
        belief(50, 10, 9.0, 3, 10, own=0.2, geometry=10, evidence=4.0),  # geometry corrects the paradigm
        belief(51, 4, 8.0, 11, own=0.9, geometry=11, evidence=9.0),  # the last stage spoils it
        belief(20, 4, 2.0, 4, own=0.5, geometry=4, evidence=6.0),  # no revisit
    ]
    curves = measure_stages(beliefs, TRUTH).curves
    assert curves["own"].thresholds.tolist() == [0.9, 0.5, 0.2]
    assert curves["own"].true_positives.tolist() == [1, 1, 1]
    assert curves["geometry"].thresholds.tolist() == [9.0, 6.0, 4.0]
    assert curves["geometry"].true_positives.tolist() == [1, 1, 2]
    assert curves["temporal"].true_positives.tolist() == [1, 1, 1]
    assert curves["temporal"].recall_at_full_precision == 1 / LAP
    assert {curve.truth_rows for curve in curves.values()} == {LAP}


def test_only_the_last_stage_knows_that_a_verification_failed():
    failed = Belief(50, 10, 9.0, False, verified=False, stages=StageScores((10,), 3.0, 10, 2.0))
    results = measure_stages([failed], TRUTH)
    assert len(results.curves["temporal"].thresholds) == 0
    assert results.curves["own"].true_positives.tolist() == [1]
    assert results.curves["geometry"].true_positives.tolist() == [1]


def test_what_a_recogniser_does_not_report_is_left_out_and_the_last_stage_never():
    bare = [Belief(50, None, 0.0, accepted=False)]
    assert set(measure_stages(bare, TRUTH).curves) == {"temporal"} == set(stage_intervals(bare, TRUTH))
    assert measure_stages(bare, TRUTH).candidate_recall == {}
    proposing = [belief(50, None, 0.0, 10)]
    assert set(measure_stages(proposing, TRUTH).curves) == {"own", "temporal"}
    assert set(stage_intervals(proposing, TRUTH)) == {"candidates", "own", "temporal"}


def test_a_candidate_counts_from_its_rank_on():
    others = [1, 2, 3, 4, 5, 6, 7, 8, 9]
    beliefs = [
        belief(50, None, 0.0, 10, *others),
        belief(60, None, 0.0, *others[:4], 20, *others[4:]),
        belief(61, None, 0.0, *others[:5], 21, *others[5:]),
        belief(62, None, 0.0, *others, 22),
        belief(63, None, 0.0, *others),
        belief(30, None, 0.0, 10),  # no revisit: nothing is true of it
    ]
    assert candidate_ranks(beliefs, TRUTH).tolist() == [1, 5, 6, 10, np.inf, np.inf]
    assert measure_stages(beliefs, TRUTH).candidate_recall == {1: 1 / LAP, 5: 2 / LAP, 10: 4 / LAP}


def test_the_tolerance_holds_for_candidates_too():
    beliefs = [belief(50, None, 0.0, 20), belief(60, None, 0.0, 31)]
    assert measure_stages(beliefs, TRUTH).candidate_recall[1] == 0.0
    assert measure_stages(beliefs, TRUTH, 10).candidate_recall[1] == 1 / LAP


def test_of_several_true_candidates_the_first_counts():
    beliefs = [belief(50, None, 0.0, 30, 12, 9, 10)]
    assert candidate_ranks(beliefs, TRUTH).tolist() == [4]
    assert candidate_ranks(beliefs, TRUTH, 5).tolist() == [2]


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_each_image_once_gives_the_values_of_the_curve_itself(seed):
    rng = np.random.default_rng(seed)
    answers = [
        Belief(query, int(rng.integers(query)), float(rng.integers(6)), False, verified=bool(rng.random() < 0.9))
        for query in range(1, 2 * LAP)
    ]
    answers[50:] = [Belief(b.query, b.query - LAP, b.score + 1.5, False) for b in answers[50:]]
    curve = precision_recall(answers, TRUTH)
    intervals = curve_intervals(answers, TRUTH, np.ones((1, 2 * LAP), np.int64))
    values = (curve.recall_at_full_precision, curve.area_under_curve, curve.average_precision)
    for name, value in zip(CURVE_SUMMARIES, values, strict=True):
        assert intervals[name] == pytest.approx((value, value))


def test_an_image_that_a_sample_lacks_is_no_detection_of_it_and_one_drawn_twice_counts_twice():
    answers = [belief(50, 3, 9.0), belief(51, 11, 8.0), belief(52, 12, 7.0)]  # the best is false
    weights = np.ones((1, 2 * LAP), np.int64)
    weights[0, 50] = 0
    lacking = curve_intervals(answers, TRUTH, weights)
    assert lacking["recall_at_100_precision"] == pytest.approx((2 / (LAP - 1),) * 2)
    assert lacking["area_under_curve"] == lacking["average_precision"] == pytest.approx((2 / (LAP - 1),) * 2)
    weights[0, 51] = 2
    assert curve_intervals(answers, TRUTH, weights)["recall_at_100_precision"] == pytest.approx((3 / LAP,) * 2)


def test_one_false_detection_ends_the_recall_at_full_precision():
    answers = [belief(50, 10, 9.0), belief(51, 3, 8.0), belief(52, 12, 7.0)]
    found = curve_intervals(answers, TRUTH, np.ones((1, 2 * LAP), np.int64))
    assert found["recall_at_100_precision"] == pytest.approx((1 / LAP,) * 2)


def test_samples_are_as_long_as_the_recording_and_made_of_blocks():
    weights = sample_weights(400, seed=3, samples=200)
    assert weights.sum(axis=1).tolist() == [400] * 200
    np.testing.assert_array_equal(weights, sample_weights(400, seed=3, samples=200))
    assert not np.array_equal(weights, sample_weights(400, seed=4, samples=200))
    # An image of a block has its neighbours beside it: counts change at the edges of blocks alone.
    changes = np.count_nonzero(np.diff(weights, axis=1, append=weights[:, :1]), axis=1)
    assert changes.max() <= 2 * 400 // MAX_BLOCK_IMAGES
    assert weights.mean(axis=0) == pytest.approx(np.ones(400), abs=0.35)  # the ends as often as the middle


def test_neighbours_that_fail_together_widen_the_interval():
    """Half of the revisits are missed: one stretch of them leaves more to luck than every second image."""
    truth = np.eye(800, k=-400) > 0
    stretch, alternate = (
        [belief(q, q - 400 if found(q) else None, 1.0) for q in range(400, 800)]
        for found in (lambda q: q < 600, lambda q: q % 2 == 0)
    )
    widths = [
        np.diff(stage_intervals(beliefs, truth)["temporal"]["average_precision"]) for beliefs in (stretch, alternate)
    ]
    assert widths[0] > 3 * widths[1]


def test_the_interval_of_a_share_is_that_of_its_blocks():
    """Blocks that are wholly right or wholly wrong: the share of right ones is binomial over the blocks."""
    truth = np.eye(4000, k=-2000) > 0
    rng = np.random.default_rng(1)
    right = np.repeat(rng.random(2000 // MAX_BLOCK_IMAGES) < 0.5, MAX_BLOCK_IMAGES)
    beliefs = [belief(2000 + k, None, 0.0, k if right[k] else k + 1) for k in range(2000)]
    low, high = stage_intervals(beliefs, truth)["candidates"]["recall_at_1"]
    sigma = 0.5 / np.sqrt(2000 / MAX_BLOCK_IMAGES)
    assert (low + high) / 2 == pytest.approx(right.mean(), abs=0.03)
    assert high - low == pytest.approx(2 * 1.96 * sigma, rel=0.35)


@pytest.mark.parametrize("images", [1, 2, 9, 25])
def test_short_recordings_have_samples_too(images):
    weights = sample_weights(images)
    assert weights.shape == (1000, images)
    assert (weights.sum(axis=1) == images).all()


def test_nothing_detected_is_an_interval_of_zeros():
    nothing = curve_intervals([Belief(50, None, 0.0, accepted=False)], TRUTH, sample_weights(2 * LAP))
    assert nothing == dict.fromkeys(CURVE_SUMMARIES, (0.0, 0.0))


def test_a_stage_without_a_score_has_no_answer():
    answers = stage_answers([Belief(50, 10, 1.0, True, stages=StageScores((10,), None, 10, None))], "own")
    assert [answer.match for answer in answers] == [None]
    assert stage_answers([belief(50, 10, 1.0, 10, geometry=10)], "geometry")[0].match is None
