"""The delayed decision answers each query exactly once and in order, whatever the candidates."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from place_recognition.belief.candidate_verification import VerificationResult
from place_recognition.belief.sequence_consensus import CandidateBeliefs, DelayedDecision, SequenceConsensusConfig
from place_recognition.image_processing.local_features import LocalFeatures
from place_recognition.map.image_history import ImageHistory
from place_recognition.recognizer import Belief

IMAGES = 120
MAX_GAP_IMAGES = 2  # of the gap filler


def make_history() -> ImageHistory:
    """A history of images with twenty features each."""
    ones = np.ones(20, np.float32)
    features = LocalFeatures(np.zeros((20, 2), np.float32), ones, ones, np.full((20, 4), 0.5, np.float32))
    history = ImageHistory()
    for k in range(IMAGES):
        history.add(k, features, float("nan"))
    return history


HISTORY = make_history()


def candidates(query: int, evidence: list[float]) -> CandidateBeliefs:
    """Candidates of a revisit 60 images after the first pass; one for each evidence, 20 locations apart."""
    results = tuple(VerificationResult(query, (query - 60 + 20 * k) % 60, 30, e, True) for k, e in enumerate(evidence))

    def believe(result: VerificationResult) -> Belief:
        return Belief(query, result.location, result.evidence, accepted=True, inliers=30)

    return CandidateBeliefs.from_results(query, results, believe)


def decide(evidence: list[list[float]], config: SequenceConsensusConfig) -> tuple[list[Belief], list[int]]:
    """All beliefs about the images from 60 on, and how many there were after each image."""
    decision, beliefs, counts = DelayedDecision(HISTORY, config), [], []
    for query, values in enumerate(evidence, start=60):
        beliefs += decision.add(candidates(query, values))
        counts.append(len(beliefs))
    return beliefs + decision.finish(), counts


EVIDENCE = st.lists(st.lists(st.floats(0, 80), max_size=3), max_size=40)


@settings(max_examples=60, deadline=None)
@given(EVIDENCE, st.integers(0, 15))
def test_each_query_is_answered_once_in_order_and_in_time(evidence, window):
    beliefs, counts = decide(evidence, SequenceConsensusConfig(window=window))
    assert [belief.query for belief in beliefs] == list(range(60, 60 + len(evidence)))
    assert all(count >= k + 1 - window - MAX_GAP_IMAGES for k, count in enumerate(counts))


@settings(max_examples=60, deadline=None)
@given(EVIDENCE)
def test_a_match_is_one_of_the_candidates_or_filled_into_a_gap(evidence):
    for belief in decide(evidence, SequenceConsensusConfig())[0]:
        named = [result.location for result in candidates(belief.query, evidence[belief.query - 60]).results]
        assert belief.match is None or belief.match in named or not belief.accepted


@settings(max_examples=60, deadline=None)
@given(EVIDENCE)
def test_beliefs_do_not_depend_on_images_beyond_the_window(evidence):
    config = SequenceConsensusConfig(window=5)
    whole, counts = decide(evidence, config)
    for end in range(0, len(evidence), 7):
        begun = decide(evidence[:end], config)[0][: counts[end - 1] if end else 0]
        assert begun == whole[: len(begun)]


def test_a_short_gap_in_a_revisit_is_filled_and_not_accepted():
    evidence = [[60.0]] * 10 + [[]] * 2 + [[60.0]] * 10
    beliefs, _ = decide(evidence, SequenceConsensusConfig())
    assert [belief.match for belief in beliefs] == list(range(22))
    assert [belief.accepted for belief in beliefs[10:12]] == [False, False]
    assert all(belief.accepted for belief in beliefs[:10] + beliefs[12:])
