"""Hierarchical places by themselves: first the place by its votes, then the images in it."""

import numpy as np
import pytest
from landmark_street import history_of
from place_images import LAP_IMAGES, changed, kitti_images, observed_images, two_laps
from scipy.stats import binom

from place_recognition.map.image_history import ImageHistory
from place_recognition.paradigms.hierarchical_places import HierarchicalPlaces, HierarchicalPlacesConfig
from place_recognition.vocabulary.word_tree import ExactWordIndex


class Rows(dict):
    """The rows of the matrix, by query."""

    def add(self, query, matches, values, stage="similarity"):
        self[query] = (matches, values)


class CountingIndex(ExactWordIndex):
    """Remembers how many words there were at each question."""

    def __init__(self):
        super().__init__()
        self.sizes = []

    def nearest(self, query):
        self.sizes.append(len(self))
        return super().nearest(query)


def drive(images=None, config=None, index=ExactWordIndex, after_each=lambda proposer, image, proposals: None):
    """The proposer, its rows and its proposals."""
    rows, history, found = Rows(), ImageHistory(), []
    proposer = HierarchicalPlaces(history, config, rows, index)
    for image in observed_images(images):
        history.add(image.location, image.features, float("nan"))
        now = proposer.observe(image)
        after_each(proposer, image, now[0])
        found += now
    return proposer, rows, found + proposer.finish()


@pytest.fixture(scope="module")
def laps():
    return drive()


def place_densities(proposer: HierarchicalPlaces, image) -> dict[int, float]:
    """Binomial probability of the votes for each place that has more than expected, counted by hand."""
    places = proposer._places
    count = places.activate_until(image.last_matchable)
    total = places.count_words_of_first(count)
    hit = places.nearest_words(image.features.descriptors[: proposer.config.voting_features])
    hit = {int(word) for word in hit if word < total}
    found = {}
    for place in range(count):
        share = int(places.word_counts(np.array([place]))[0]) / total
        votes = sum(int(places.places_of(np.array([word]))[0]) == place for word in hit)
        if votes > len(hit) * share:
            found[place] = binom.logpmf(votes, len(hit), share)
    return found


def test_a_score_is_the_number_of_powers_of_ten_by_which_the_votes_of_the_place_are_unlikely():
    checked = []

    def check(proposer, image, proposals):
        if image.location % 8:
            return
        densities = place_densities(proposer, image)
        for location, score in zip(proposals.locations, proposals.scores, strict=True):
            expected = -densities.get(proposer._places.place_of(location), 0.0) / np.log(10)
            assert score == pytest.approx(expected, rel=1e-9)
            checked.append(score)

    drive(after_each=check)
    assert len(checked) > 8
    assert max(checked) > 5


def test_the_likeliest_places_are_searched_and_no_others():
    config = HierarchicalPlacesConfig(max_places=2, neighbor_places=0)

    def check(proposer, image, proposals):
        densities = place_densities(proposer, image) if image.location % 8 == 0 else {}
        if densities:
            best = sorted(densities, key=lambda place: densities[place])[:2]
            assert {proposer._places.place_of(location) for location in proposals.locations} <= set(best)

    drive(config=config, after_each=check)


def test_the_image_of_most_matches_comes_first(laps):
    found = [one for one in laps[2][LAP_IMAGES:] if one.locations]
    assert len(found) > 30
    assert np.mean([abs(one.locations[0] + LAP_IMAGES - one.query) <= 2 for one in found]) > 0.9


def test_all_images_belong_to_places_once_the_drive_has_ended(laps):
    proposer = laps[0]
    places = proposer._places
    located = [location for place in range(len(places)) for location in places.images(place)]
    assert located == list(range(len(two_laps())))
    assert proposer.word_count == places.count_words_of_first(len(places)) > 10 * len(places)


def test_the_votes_of_an_image_go_to_the_place_that_holds_its_match(laps):
    _, rows, proposals = laps
    query = LAP_IMAGES + 15
    locations, votes = rows[query]
    assert votes.min() > 0
    assert proposals[query].locations[0] in locations[votes == votes.max()]


def test_words_are_searched_only_when_their_place_may_be_matched():
    indices = []
    proposer, _, _ = drive(index=lambda: indices.append(CountingIndex()) or indices[-1])
    sizes = indices[0].sizes
    assert sizes == sorted(sizes)
    assert 0 < sizes[-1] < proposer.word_count


def test_an_image_with_hardly_any_features_proposes_nothing():
    images = list(two_laps())
    images[60] = np.full_like(images[0], 90)
    proposals = drive(images)[2]
    assert proposals[60].locations == ()
    assert proposals[61].locations


def test_another_seed_grows_other_words_and_finds_the_same_places(laps):
    proposer, _, proposals = drive(config=HierarchicalPlacesConfig(seed=1))
    words = [one._places.nearest_words(np.eye(64, dtype=np.float32)) for one in (proposer, laps[0])]
    assert not np.array_equal(*words)
    second = [one for one in proposals[LAP_IMAGES:] if one.locations]
    assert np.mean([abs(one.locations[0] + LAP_IMAGES - one.query) <= 2 for one in second]) > 0.9


def test_a_second_pass_of_real_images_gets_the_right_place_as_first_proposal(test_data):
    frames = [kitti_images(test_data, "07", range(60)), kitti_images(test_data, "05", range(44))]
    first = [image for images in frames for image in images[::2]]
    second = [changed(image, seed) for images in frames for seed, image in enumerate(images[1::2])]
    proposals = drive(first + second)[2][len(first) :]
    best = [abs(one.locations[0] + len(first) - one.query) if one.locations else 99 for one in proposals]
    assert np.mean(np.array(best) <= 3) > 0.9


def test_without_features_in_the_history_there_is_nothing_to_rank():
    proposer = HierarchicalPlaces(history_of([]))
    assert proposer.finish() == []
    assert proposer.word_count == 0
