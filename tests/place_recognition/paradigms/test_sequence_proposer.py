"""Both paradigms of sequences by themselves: the equations act, and the filter decides what is proposed."""

import math
from dataclasses import replace

import numpy as np
import pytest
from place_images import make_observed, observed_images, propose_all

from place_recognition.belief.matrix_filter import DIAGONAL, LEARNED, FilterConfig, filter_matrix
from place_recognition.image_processing.surf import Surf
from place_recognition.map.sequence_map import FixedDistanceConfig, FixedDistanceSegmentation
from place_recognition.paradigms.sequences import (
    SequenceMatchingConfig,
    SequenceProposer,
    make_dynamic_sequences,
    make_sequence_histograms,
)
from place_recognition.vocabulary.vocabulary import FlatVocabulary, default_vocabulary

PARADIGMS = pytest.mark.parametrize("make", [make_sequence_histograms, make_dynamic_sequences])
WORDS, IMAGES_A_SEQUENCE = 128, 2
WEIGHTS = np.linspace(2.5, 1, WORDS).astype(np.float32)
VOCABULARY = FlatVocabulary("test", np.eye(WORDS, dtype=np.float32), WEIGHTS)
ALL = SequenceMatchingConfig(max_query_words=10_000, max_sequences=1, max_similar_sequences=0, neighbor_sequences=0)
PASS, DECOY = 10, 14  # sequences of the first pass; the sequence that looks most like one of the second pass


class Rows(dict):
    """The rows of both matrices, by stage and query."""

    def add(self, query, matches, values, stage="similarity"):
        self[stage, query] = (matches, values)


def sequence_words() -> list[list[int]]:
    """Words of the images of a pass, of other places with a decoy among them, and of the same pass again.

    A sequence of the second pass shares half of its words with the one of the first. The decoy shares more with the
    sixth, but alone.
    """
    rng = np.random.default_rng(0)
    own = [list(range(6 * k, 6 * k + 8)) for k in range(PASS)]  # neighbours share two words
    elsewhere = [rng.integers(100, 128, 6).tolist() for _ in range(8)]
    again = [own[k][1:6] + rng.integers(64, 100, 4).tolist() for k in range(PASS)]
    elsewhere[DECOY - PASS] = again[5][:7]
    return own + elsewhere + again


def drive(config=ALL, matrix_filter=None, words=None):
    """Proposals by query, and rows, of a drive of sequences of two images; the latest 4 sequences are no past."""
    rows, images = Rows(), []
    for sequence, present in enumerate(words or sequence_words()):
        for _ in range(IMAGES_A_SEQUENCE):
            location = len(images)
            descriptors = VOCABULARY.words[present]
            images.append(make_observed(location, descriptors, max(IMAGES_A_SEQUENCE * (sequence - 4) - 1, -1)))
    segmentation = FixedDistanceSegmentation(FixedDistanceConfig(unmeasured_images=IMAGES_A_SEQUENCE))
    proposer = SequenceProposer("test", VOCABULARY, segmentation, config, matrix_filter or FilterConfig(), rows)
    return {one.query: one for one in propose_all(proposer, images)}, rows


def written_out_matrix(config: SequenceMatchingConfig) -> np.ndarray:
    """Normalised scores (S, S) of all sequences by plain algebra, NaN where they may not be matched."""
    counts = [np.bincount(words * IMAGES_A_SEQUENCE, minlength=WORDS) for words in sequence_words()]
    vectors = np.array([count**config.tf_power * WEIGHTS for count in counts])
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    scores = 1 - np.sqrt(np.maximum(1 - vectors @ vectors.T, 0))  # equation 4.6, stretched to [0, 1]
    matrix = np.full(scores.shape, np.nan)
    for k in range(len(scores)):
        previous = scores[k, k - 1] if k else 1.0
        matrix[k, : max(k - 4, 0)] = scores[k, : max(k - 4, 0)] / max(previous, config.min_previous_score)
    return matrix


def recorded_matrix(rows: Rows, stage: str, size: int) -> np.ndarray:
    matrix = np.full((size, size), np.nan)
    for (name, query), (matches, values) in rows.items():
        if name == stage:
            matrix[query // IMAGES_A_SEQUENCE, np.array(matches, np.int64) // IMAGES_A_SEQUENCE] = values
    return matrix


@pytest.mark.parametrize("tf_power", [0.5, 1.0])
def test_a_row_holds_the_scores_divided_by_that_with_the_sequence_before(tf_power):
    """Equations 4.6 and 4.7 act in the paradigm, not only in their functions."""
    config = replace(ALL, tf_power=tf_power)
    _, rows = drive(config)
    expected = written_out_matrix(config)
    np.testing.assert_allclose(recorded_matrix(rows, "similarity", len(expected)), expected, atol=2e-3)
    assert np.nanmax(expected) > 1  # an undivided score is at most 1


@pytest.mark.parametrize("kernel", [DIAGONAL, LEARNED])
def test_the_response_is_that_of_the_filtered_matrix(kernel):
    _, rows = drive(matrix_filter=FilterConfig(kernel, 1.0))
    matrix = recorded_matrix(rows, "similarity", len(sequence_words()))
    expected = filter_matrix(matrix, kernel)
    np.testing.assert_allclose(recorded_matrix(rows, "filtered", len(matrix)), expected, atol=1e-4)


def sequences_proposed(proposals, query_sequence: int) -> set[int]:
    queries = range(IMAGES_A_SEQUENCE * query_sequence, IMAGES_A_SEQUENCE * (query_sequence + 1))
    return {location // IMAGES_A_SEQUENCE for query in queries for location in proposals[query].locations}


QUERY = PASS + 8 + 5  # the sequence of the second pass that the decoy resembles


def test_the_response_of_the_filter_decides_which_sequences_propose():
    matrix = written_out_matrix(ALL)
    assert np.nanargmax(matrix[QUERY]) == DECOY  # by plain similarity
    assert sequences_proposed(drive()[0], QUERY) == {5}
    by_similarity, _ = drive(replace(ALL, max_sequences=0, max_similar_sequences=1))
    assert sequences_proposed(by_similarity, QUERY) == {DECOY}
    both, _ = drive(replace(ALL, max_similar_sequences=1))
    assert sequences_proposed(both, QUERY) == {5, DECOY}


def test_neighbouring_sequences_propose_too():
    proposals, _ = drive(replace(ALL, neighbor_sequences=1, min_separation=1))
    found = sequences_proposed(proposals, QUERY)
    assert 5 in found
    assert found <= {4, 5, 6}


def test_the_response_is_part_of_the_score_and_all_of_it_in_the_published_method():
    config = replace(ALL, max_similar_sequences=1, min_separation=1)
    matrix_filter = FilterConfig(DIAGONAL, 0.32)
    plain, rows = drive(replace(config, response_weight=0.0), matrix_filter)
    weighted, _ = drive(replace(config, response_weight=0.1), matrix_filter)
    alone, _ = drive(replace(config, response_weight=math.inf), matrix_filter)
    matrix, seen = recorded_matrix(rows, "filtered", len(sequence_words())), 0
    for query, proposals in plain.items():
        responses = {k: matrix[query // IMAGES_A_SEQUENCE, k // IMAGES_A_SEQUENCE] for k in proposals.locations}
        scores = dict(zip(proposals.locations, proposals.scores, strict=True))
        for location, score in zip(weighted[query].locations, weighted[query].scores, strict=True):
            expected = scores[location] + 0.1 * max(responses[location], 0) / 0.32
            assert score == pytest.approx(expected, abs=1e-4)
        for location, score in zip(alone[query].locations, alone[query].scores, strict=True):
            assert score == pytest.approx(responses[location], abs=1e-4)
            seen += 1
    assert seen > 20
    assert alone[IMAGES_A_SEQUENCE * QUERY].locations[0] // IMAGES_A_SEQUENCE == 5


def test_scores_of_a_revisit_stand_out_from_those_of_other_places():
    proposals, _ = drive(
        replace(ALL, neighbor_sequences=1, max_sequences=4, max_similar_sequences=4, response_weight=0.05)
    )
    second = [proposals[k].scores[0] for k in range(IMAGES_A_SEQUENCE * (PASS + 9), IMAGES_A_SEQUENCE * (PASS + 17))]
    first = [score for k in range(IMAGES_A_SEQUENCE * (PASS + 7)) for score in proposals[k].scores[:1]]
    assert min(second) > max(first, default=0.0)


def test_a_pass_in_the_opposite_direction_is_suppressed_by_the_filter_and_proposed_by_similarity():
    words = sequence_words()
    backwards = words[: PASS + 8] + words[: PASS + 7 : -1]
    query = PASS + 8 + 3  # its sequence was the seventh of the first pass
    filtered, _ = drive(matrix_filter=FilterConfig(LEARNED, 3.5), words=backwards)
    both, _ = drive(replace(ALL, max_similar_sequences=2), FilterConfig(LEARNED, 3.5), backwards)
    assert 6 in sequences_proposed(both, query)
    assert 6 not in sequences_proposed(filtered, query)


@PARADIGMS
@pytest.mark.parametrize("count", range(4))
def test_runs_of_at_most_one_sequence_are_answered(make, count):
    proposals = propose_all(make("surf-upright-64", default_vocabulary()), observed_images()[:count])
    assert [(one.query, one.locations) for one in proposals] == [(k, ()) for k in range(count)]


@PARADIGMS
def test_a_vocabulary_of_other_features_is_refused(make):
    words = FlatVocabulary("orb-256", np.eye(256, dtype=np.float32), np.ones(256, np.float32))
    with pytest.raises(ValueError, match="expected a vocabulary of surf-upright-64 features, found one of orb-256"):
        make(Surf().kind, words)


def test_an_unknown_score_is_refused():
    with pytest.raises(ValueError, match="expected a score of scaled-l2, l2, cosine, got 'l1'"):
        SequenceMatchingConfig(score="l1")
    with pytest.raises(ValueError, match="expected an image_score of correlation, l2, got 'l1'"):
        SequenceMatchingConfig(image_score="l1")
