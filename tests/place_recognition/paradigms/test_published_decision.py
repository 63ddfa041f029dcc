"""Each threshold of a published method acts: just above it a match is accepted, just below it is not."""

import copy

import numpy as np
import pytest
from landmark_street import history_of, make_features

from place_recognition.paradigms.published import PublishedDecision, PublishedDecisionConfig
from place_recognition.recognizer import Proposals
from place_recognition.verification.candidate_verification import VerificationResult

HISTORY = history_of([make_features(np.zeros((9, 2)), np.ones((9, 4), np.float32) / 2)] * 200)
OPEN = {"min_score": 0.0, "min_inliers": 0, "min_consistent_frames": 1, "max_gap_frames": 10}


def decide(matches, decision=None, **thresholds):
    """Beliefs about queries from 150 on: each match is (location, score, inliers), or None without candidates."""
    decision = decision or PublishedDecision(HISTORY, PublishedDecisionConfig(**{**OPEN, **thresholds}))
    beliefs = []
    for query, match in enumerate(matches, start=150):
        if match is None:
            beliefs += decision.add(Proposals(query, 100), ())
            continue
        location, score, inliers = match
        result = VerificationResult(query, location, inliers, 1.0, np.zeros((inliers, 4), np.float32))
        beliefs += decision.add(Proposals(query, 100, (location,), (score,)), (result,))
    assert decision.finish() == []
    assert [belief.query for belief in beliefs] == list(range(150, 150 + len(matches)))
    return beliefs


def accepted(matches, **thresholds) -> list[bool]:
    return [belief.accepted for belief in decide(matches, **thresholds)]


def test_the_score_is_a_gate():
    assert accepted([(7, 3.5, 50)], min_score=3.5) == [True]
    assert accepted([(7, 3.4999, 50)], min_score=3.5) == [False]


def test_a_match_below_the_score_is_still_reported_with_its_score():
    [belief] = decide([(7, 1.0, 50)], min_score=3.5)
    assert (belief.match, belief.score, belief.inliers, belief.verified) == (7, 1.0, 50, True)


def test_the_number_of_inliers_is_a_gate():
    assert accepted([(7, 1.0, 12)], min_inliers=12) == [True]
    [belief] = decide([(7, 1.0, 11)], min_inliers=12)
    assert (belief.match, belief.accepted, belief.verified) == (None, False, False)


def test_with_no_inliers_asked_for_geometry_decides_nothing():
    assert accepted([(7, 1.0, 0)], min_inliers=0) == [True]


def test_as_many_successive_images_must_agree():
    line = [(7 + k, 1.0, 50) for k in range(5)]
    assert accepted(line, min_consistent_frames=1) == [True] * 5
    assert accepted(line, min_consistent_frames=2) == [False, True, True, True, True]
    assert accepted(line, min_consistent_frames=4) == [False, False, False, True, True]


@pytest.mark.parametrize("direction", [1, -1])
def test_the_matches_of_successive_images_must_lie_near_one_another(direction):
    near, far = [(50, 1.0, 50), (50 + 10 * direction, 1.0, 50)], [(50, 1.0, 50), (50 + 11 * direction, 1.0, 50)]
    assert accepted(near, min_consistent_frames=2, max_gap_frames=10) == [False, True]
    assert accepted(far, min_consistent_frames=2, max_gap_frames=10) == [False, False]


@pytest.mark.parametrize(
    "between", [None, (8, 0.5, 50), (8, 2.0, 3)], ids=["no candidate", "too small a score", "too few inliers"]
)
def test_an_image_that_fails_any_gate_interrupts_the_agreement(between):
    matches = [(7, 2.0, 50), between, (9, 2.0, 50), (10, 2.0, 50)]
    thresholds = {"min_score": 1.0, "min_inliers": 12, "min_consistent_frames": 2}
    assert accepted(matches, **thresholds) == [False, False, False, True]


def test_an_image_of_its_own_gate_is_not_accepted_because_others_agree():
    matches = [(7, 2.0, 50), (8, 2.0, 50), (9, 0.5, 50)]
    assert accepted(matches, min_score=1.0) == [True, True, False]


def test_only_the_first_candidate_counts():
    decision = PublishedDecision(HISTORY, PublishedDecisionConfig(**{**OPEN, "min_inliers": 12}))
    results = (VerificationResult(150, 7, 5, 1.0), VerificationResult(150, 40, 90, 60.0))
    [belief] = decision.add(Proposals(150, 100, (7, 40), (2.0, 1.0)), results)
    assert not belief.accepted
    assert belief.match is None


def test_a_restored_decision_remembers_the_latest_matches():
    thresholds = {"min_consistent_frames": 3}
    decision = PublishedDecision(HISTORY, PublishedDecisionConfig(**{**OPEN, **thresholds}))
    decide([(7, 1.0, 50), (8, 1.0, 50)], decision)
    restored = PublishedDecision(HISTORY, PublishedDecisionConfig(**{**OPEN, **thresholds}))
    restored.restore(copy.deepcopy(decision.state()))
    assert [belief.accepted for belief in decide([(9, 1.0, 50)], restored)] == [True]
