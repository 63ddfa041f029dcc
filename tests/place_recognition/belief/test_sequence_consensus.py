"""Matches on one line with their neighbours are accepted, others are not, and every query gets one belief."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from place_recognition.belief.candidate_verification import VerificationResult
from place_recognition.belief.sequence_consensus import CandidateBeliefs, SequenceConsensus, SequenceConsensusConfig
from place_recognition.recognizer import Belief


def candidates(query: int, *places: tuple[int, float]) -> CandidateBeliefs:
    """Candidate beliefs of an image that may show one of the places (location, evidence)."""
    if not places:
        return CandidateBeliefs.without_match(query)
    results = tuple(VerificationResult(query, location, 30, evidence, verified=True) for location, evidence in places)
    beliefs = (Belief(query, r.location, r.evidence, accepted=True, inliers=30) for r in results)
    return CandidateBeliefs(tuple(beliefs), results)


def decide(sequence: list[CandidateBeliefs], config: SequenceConsensusConfig | None = None) -> dict[int, Belief]:
    consensus = SequenceConsensus(config)
    beliefs = [belief for one in sequence for belief in consensus.add(one)] + consensus.finish()
    return {belief.query: belief for belief in beliefs}


def on_line(first: int, end: int, evidence: float) -> list[CandidateBeliefs]:
    """Candidates of a revisit at the same speed, 300 images after the first pass."""
    return [candidates(q, (q - 300, evidence)) for q in range(first, end)]


@pytest.mark.parametrize("speed", [-1.2, -1.0, 0.8, 1.0, 1.25])
def test_weak_images_on_one_line_are_accepted_together(speed):
    beliefs = decide([candidates(q, (300 + round(speed * q), 25.0)) for q in range(100, 140)])
    assert all(beliefs[q].accepted for q in range(105, 135))


def test_the_same_weak_images_off_any_line_are_not():
    scattered = [17, 205, 90, 3, 260, 130, 44, 180, 71, 233] * 4
    beliefs = decide([candidates(q, (scattered[q - 300], 25.0)) for q in range(300, 340)])
    assert not any(belief.accepted for belief in beliefs.values())


def test_many_images_of_little_evidence_do_not_add_up():
    """The evidence of 26 images of two streets with the same kerbs and cars, from a simulated drive."""
    evidence = [9, 12, 14, 13, 14, 16, 17, 12, 10, 10, 11, 7, 6, 31, 13, 9, 9, 9, 12, 8, 18, 15, 21, 13, 8, 6]

    def score_of_the_middle(factor: float) -> float:
        street = [candidates(3480 + k, (3360 + k, factor * value)) for k, value in enumerate(evidence)]
        return decide(street)[3493].score

    assert score_of_the_middle(1) < 150
    assert score_of_the_middle(4) > 500  # images of much evidence do


def test_of_two_candidates_the_one_on_the_line_is_chosen_though_it_has_less_evidence():
    sequence = [candidates(q, (q - 300, 15.0)) for q in range(400, 430)]
    sequence[15] = candidates(415, (20, 35.0), (115, 5.0))
    assert decide(sequence)[415].match == 115


def test_where_a_revisit_ends_the_own_evidence_of_an_image_counts_most():
    revisit = [candidates(q, (q - 300, 30.0)) for q in range(400, 430)]
    after = [candidates(q, (q - 300, 1.0)) for q in range(430, 440)]  # the right street from afar
    beliefs = decide(revisit + after)
    assert beliefs[429].accepted
    assert not beliefs[439].accepted
    assert beliefs[435].score < 0.1 * beliefs[415].score


def test_matches_of_a_street_seen_from_afar_are_contradicted_by_the_images_in_it():
    before = [candidates(q, ((0, 3, 1, 4)[q % 4], 25.0), (5, 15.0)) for q in range(396, 416)]  # from afar
    beliefs = decide(before + [candidates(q, (q - 417, 100.0)) for q in range(417, 450)])
    assert not any(beliefs[q].accepted for q in range(402, 416))
    assert all(beliefs[q].accepted for q in range(417, 440))


def test_evidence_far_away_on_both_sides_does_not_fill_a_gap():
    """The earlier pass turned off, the later one went on, and comes to a street that looks like the one it knows."""
    revisit, gap, alike = range(400, 420), range(420, 440), range(440, 460)
    line = [candidates(q, (q - 300, 0.3 if q in gap else 30.0)) for q in [*revisit, *gap, *alike]]
    beliefs = decide(line)
    assert not any(beliefs[q].accepted for q in range(427, 433))
    assert all(beliefs[q].accepted for q in range(405, 420))


def test_an_image_of_as_much_evidence_is_not_contradicted():
    """The earlier pass stood still here for twenty images."""
    revisit = [candidates(q, (q - 300 if q < 415 else q - 280, 90.0)) for q in range(400, 430)]
    assert all(belief.accepted for belief in decide(revisit).values())


def test_without_a_window_every_image_is_decided_alone_and_at_once():
    consensus = SequenceConsensus(SequenceConsensusConfig.disabled())
    [belief] = consensus.add(candidates(400, (100, 20.0), (7, 30.0)))
    assert (belief.match, belief.score, belief.accepted) == (7, 30.0, True)
    assert consensus.finish() == []


def test_a_belief_that_the_paradigm_rejects_stays_rejected():
    rejected = [replace(one, beliefs=(replace(one.beliefs[0], accepted=False),)) for one in on_line(400, 440, 50.0)]
    assert not any(belief.accepted for belief in decide(rejected).values())


@given(st.lists(st.integers(0, 3), max_size=60), st.integers(0, 5))
def test_every_query_gets_one_belief_in_order_window_images_late(counts, window):
    consensus, out = SequenceConsensus(SequenceConsensusConfig(window=window)), []
    for k, count in enumerate(counts):
        out += consensus.add(candidates(k + 100, *((3 * k + n, 10.0) for n in range(count))))
        assert len(out) == max(k + 1 - window, 0)
    out += consensus.finish()
    assert [belief.query for belief in out] == list(range(100, 100 + len(counts)))
    assert [belief.match is None for belief in out] == [count == 0 for count in counts]


@given(st.integers(0, 2**32 - 1), st.integers(0, 29), st.floats(0.0, 50.0))
def test_more_evidence_on_the_line_never_lowers_the_score(seed, index, extra):
    rng = np.random.default_rng(seed)
    evidence = rng.uniform(0.0, 19.0, 30)

    def score_of_the_middle(values):
        return decide([candidates(400 + k, (100 + k, float(value))) for k, value in enumerate(values)])[415].score

    more = evidence.copy()
    more[index] += extra
    assert score_of_the_middle(more) >= score_of_the_middle(evidence) - 1e-9


@given(st.integers(-200, 200))
def test_the_score_does_not_depend_on_where_the_drive_begins(shift):
    moved = [candidates(q + shift, (q - 300 + 2 * shift, 12.0 + q % 7)) for q in range(600, 640)]
    expected = [candidates(q, (q - 300, 12.0 + q % 7)) for q in range(600, 640)]
    assert [b.score for b in decide(moved).values()] == [b.score for b in decide(expected).values()]


def test_the_support_of_an_image_is_symmetric_in_time():
    evidence = [float(10 + (7 * k) % 11) for k in range(31)]
    forward = [candidates(400 + k, (100 + k, value)) for k, value in enumerate(evidence)]
    backward = [candidates(400 + k, (130 - k, value)) for k, value in enumerate(reversed(evidence))]
    assert decide(forward)[415].score == pytest.approx(decide(backward)[415].score)


def test_an_image_without_neighbours_keeps_its_own_score():
    assert decide([candidates(400, (100, 30.0))])[400].score == 30.0


def test_an_image_without_candidates_is_answered_without_match():
    assert decide([candidates(400)])[400] == Belief(400, None, 0.0, accepted=False)
