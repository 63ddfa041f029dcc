"""The bag of tracked words by itself: votes against chance decide what is proposed, and in which order."""

import numpy as np
import pytest
from place_images import MIN_AGE, changed, kitti_images, observed_images, propose_all
from scipy.stats import binom

from place_recognition.paradigms.tracked_words import TrackedWords, TrackedWordsConfig
from place_recognition.recognizer import select_apart


class Rows(dict):
    """The rows of the matrix, by query."""

    def add(self, query, matches, values, stage="similarity"):
        self[query] = (matches, values)


def plain_votes(proposer: TrackedWords) -> dict[int, tuple[int, float]]:
    """Votes of the latest image for each location, and their binomial probability, counted word by word."""
    words, descriptors = proposer._words, proposer._tracks.descriptors
    hit = set(words.lookup(descriptors).tolist()) if words.active_count else set()
    spans = words.spans(np.arange(words.active_count))
    found = {}
    for location in range(int(spans[:, 1].max(initial=-1)) + 1):
        there = {k for k, (first, last) in enumerate(spans) if first <= location <= last}
        votes, share = len(hit & there), len(there) / max(len(spans), 1)
        if votes > len(hit) * share:
            found[location] = votes, binom.logpmf(votes, len(hit), share)
    return found


@pytest.fixture(scope="module")
def answers():
    """Proposals for each image of two laps, and the votes counted by hand."""
    proposer, found = TrackedWords(TrackedWordsConfig(max_places=5)), []
    for image in observed_images():
        [proposals] = proposer.observe(image)
        found.append((proposals, plain_votes(proposer)))
    return found


def test_a_score_is_the_number_of_powers_of_ten_by_which_the_votes_are_unlikely(answers):
    checked = 0
    for proposals, votes in answers:
        for location, score in zip(proposals.locations, proposals.scores, strict=True):
            assert score == pytest.approx(-votes[location][1] / np.log(10), rel=1e-9)
            checked += 1
    assert checked > 50


def test_the_least_likely_votes_come_first_and_all_places_of_more_votes_than_chance_are_considered(answers):
    for proposals, votes in answers:
        ranked = sorted(
            (density, location) for location, (_, density) in votes.items() if location <= proposals.last_matchable
        )
        order = [location for _, location in ranked]
        expected = [order[k] for k in select_apart(order, 5, 4)]
        assert list(proposals.locations) == expected


def test_the_published_method_takes_the_location_of_most_votes():
    proposer = TrackedWords(TrackedWordsConfig(max_places=1, ranking="votes"))
    checked = 0
    for image in observed_images():
        [proposals] = proposer.observe(image)
        votes = {k: v for k, (v, _) in plain_votes(proposer).items() if k <= proposals.last_matchable}
        assert bool(proposals.locations) == bool(votes)
        if votes:
            assert votes[proposals.locations[0]] == max(votes.values())
            checked += 1
    assert checked > 30


def test_the_published_method_matches_nothing_younger_than_twice_the_longest_track():
    proposer = TrackedWords(TrackedWordsConfig(exclusion_track_lengths=2))
    for image in observed_images():
        [proposals] = proposer.observe(image)
        longest = proposer._tracks.max_length_frames
        assert proposals.last_matchable == min(
            image.location - MIN_AGE if image.location >= MIN_AGE else -1, image.location - 2 * longest
        )
        assert all(location <= proposals.last_matchable for location in proposals.locations)


def test_a_word_votes_once_or_as_often_as_it_is_hit():
    images = observed_images()
    once, often = Rows(), Rows()
    propose_all(TrackedWords(TrackedWordsConfig(), once), images)
    propose_all(TrackedWords(TrackedWordsConfig(distinct_votes=False), often), images)
    totals = [(once[k][1].sum(), often[k][1].sum()) for k in once if len(once[k][1])]
    assert all(one <= other for one, other in totals)
    assert any(one < other for one, other in totals)


@pytest.fixture(scope="module")
def drives(test_data):
    """Two real drives one after the other, and their frames in between as another, changed pass."""
    frames = [kitti_images(test_data, "07", range(60)), kitti_images(test_data, "05", range(44))]
    first = [image for images in frames for image in images[::2]]
    second = [changed(image, seed) for images in frames for seed, image in enumerate(images[1::2])]
    return first, second


def test_a_second_pass_of_real_images_gets_the_right_place_as_first_proposal(drives):
    first, second = drives
    proposals = propose_all(TrackedWords(), observed_images(first + second))
    best = [abs(one.locations[0] + len(first) - one.query) if one.locations else 99 for one in proposals[len(first) :]]
    assert np.mean(np.array(best) <= 3) > 0.9
    scores = [one.scores[0] if one.scores else 0.0 for one in proposals]
    assert np.median(scores[len(first) :]) > 3 * np.max(scores[: len(first)])


def test_the_votes_of_an_image_go_to_the_place_it_matches(drives):
    first, second = drives
    rows = Rows()
    propose_all(TrackedWords(rows=rows), observed_images(first + second[:30]))
    query = len(first) + 20
    locations, votes = rows[query]
    assert votes.min() > 0
    assert abs(locations[votes.argmax()] + len(first) - query) <= 6
