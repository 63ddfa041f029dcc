"""The way is cut into places, and each word knows whose it is."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from place_images import kitti_images
from scipy.stats import binom

from place_recognition.belief.voting import vote_for_places
from place_recognition.image_processing.surf import Surf
from place_recognition.map.place_map import PlaceMap, PlaceSegmentation, PlaceSegmentationConfig
from place_recognition.vocabulary.word_tree import ExactWordIndex

EMPTY = np.empty((0, 64), np.float32)


def looks(*which):
    """Descriptors (N, 64), each the unit vector of its number."""
    return np.eye(64, dtype=np.float32)[list(which)]


def lengths(images, config=None):
    """Images of each place of a drive of descriptors."""
    formation = PlaceSegmentation(config)
    ended = [formation.add(image) for image in images] + [formation.flush()]
    return [len(place) for place in ended if place]


def surf_lengths(images):
    return lengths([Surf().extract(image).descriptors[:300] for image in images])


def place_map(words, lasts):
    """A map of places with so many words each, which can all be found; word k looks like number k."""
    places, begin = PlaceMap(ExactWordIndex()), 0
    for count, last in zip(words, lasts, strict=True):
        places.add(looks(*range(begin, begin + count)), last)
        begin += count
    places.activate_until(lasts[-1])
    return places


def test_a_place_ends_when_hardly_anything_has_stayed_in_view_since_its_begin():
    drive = [looks(*range(k, k + 10)) for k in range(20)]  # one look is lost and one is new each time
    assert lengths(drive, PlaceSegmentationConfig(min_coherent_matches=2)) == [9, 9, 2]
    assert lengths(drive, PlaceSegmentationConfig(min_coherent_matches=4)) == [7, 7, 6]


def test_what_comes_back_after_it_was_lost_does_not_count():
    steady = [looks(*range(8)), looks(*range(10, 18)), looks(*range(8))]
    assert lengths(steady) == [1, 1, 1]


def test_a_place_that_never_changes_is_cut_all_the_same():
    assert lengths([looks(*range(9))] * 40, PlaceSegmentationConfig(max_images=15)) == [15, 15, 10]


@pytest.mark.parametrize("blank", [EMPTY, looks(60, 61, 62, 63)], ids=["blank", "too few"])
def test_an_image_that_says_nothing_neither_ends_nor_begins_a_place(blank):
    image = looks(*range(9))
    assert lengths([blank, image, blank, image, blank, blank, image]) == [7]


def test_a_drive_of_blank_images_is_cut_too_and_holds_nothing():
    formation = PlaceSegmentation()
    ended = [place for _ in range(31) if (place := formation.add(EMPTY))]
    assert [len(place) for place in ended] == [15, 15]
    assert sum(len(image) for place in ended for image in place) == 0


def test_without_an_open_place_there_is_nothing_to_flush():
    assert PlaceSegmentation().flush() == []


def test_every_descriptor_of_a_place_comes_out_again():
    rng = np.random.default_rng(0)
    drive = [rng.normal(size=(rng.integers(0, 12), 64)).astype(np.float32) for _ in range(30)]
    formation = PlaceSegmentation()
    ended = [image for d in drive for image in formation.add(d)] + formation.flush()
    np.testing.assert_array_equal(np.concatenate(ended), np.concatenate(drive))


def test_a_street_is_cut_into_places_of_about_a_dozen_images(test_data):
    places = surf_lengths(kitti_images(test_data, "07", range(80)))
    assert 8 <= np.mean(places) <= 15


def test_the_cut_lies_where_one_street_follows_another(test_data):
    street, other = (kitti_images(test_data, name, range(6)) for name in ("05", "07"))
    assert surf_lengths(street + other) == [6, 6]


def test_words_images_and_places_find_each_other():
    places = place_map([3, 0, 4, 2], [4, 5, 9, 14])
    assert (len(places), places.word_count) == (4, 9)
    np.testing.assert_array_equal(places.places_of(np.arange(9)), [0, 0, 0, 2, 2, 2, 2, 3, 3])
    np.testing.assert_array_equal(places.word_counts(np.arange(4)), [3, 0, 4, 2])
    assert [places.images(p) for p in range(4)] == [range(5), range(5, 6), range(6, 10), range(10, 15)]
    assert [places.place_of(k) for k in (0, 4, 5, 6, 14)] == [0, 0, 1, 2, 3]
    np.testing.assert_array_equal(places.nearest_words(looks(5, 0)), [5, 0])


def test_words_are_found_only_when_their_place_may_be_matched():
    places = PlaceMap(ExactWordIndex())
    assert len(places.nearest_words(looks(0))) == 0
    for k in range(3):
        places.add(looks(k), last=10 * k)
    assert (places.activate_until(-1), places.activate_until(9)) == (0, 1)
    np.testing.assert_array_equal(places.nearest_words(looks(0, 2)), [0, 0])
    assert places.activate_until(25) == 3
    np.testing.assert_array_equal(places.nearest_words(looks(0, 2)), [0, 2])
    assert [places.count_words_of_first(count) for count in range(4)] == [0, 1, 2, 3]


def test_votes_are_as_improbable_as_scipy_says():
    places = place_map([10, 10, 20], [0, 1, 2])
    ballot = vote_for_places(np.array([0, 1, 2, 3, 4, 4, 10, 20, 21]), places, 3)
    np.testing.assert_array_equal(ballot.places, [0])  # the others have no more than expected
    np.testing.assert_array_equal(ballot.votes, [5])
    assert ballot.log_density[0] == pytest.approx(binom.logpmf(5, 8, 10 / 40))
    assert ballot.neg_log10_probability(0) == pytest.approx(-np.log10(binom.pmf(5, 8, 0.25)))
    assert ballot.neg_log10_probability(2) == 0


def test_the_least_likely_place_comes_first():
    places = place_map([4, 20, 40], [0, 1, 2])
    ballot = vote_for_places(np.array([0, 1, 2, *range(4, 16), *range(24, 28)]), places, 3)
    np.testing.assert_array_equal(ballot.places, [1, 0])
    assert (np.diff(ballot.log_density) >= 0).all()


def test_places_that_may_not_be_matched_yet_get_no_votes_and_do_not_count():
    places = place_map([10, 10, 20], [0, 1, 2])
    ballot = vote_for_places(np.array([0, 1, 2, 12, 30, 31]), places, 2)
    np.testing.assert_array_equal(ballot.places, [0])
    assert ballot.log_density[0] == pytest.approx(binom.logpmf(3, 4, 0.5))


def test_no_words_no_votes():
    assert len(vote_for_places(np.empty(0, np.int64), PlaceMap(ExactWordIndex()), 0).places) == 0


@settings(max_examples=60, deadline=None)
@given(st.lists(st.integers(0, 8), min_size=1, max_size=8), st.integers(0, 2**32 - 1))
def test_the_sparse_ballot_agrees_with_a_count_over_all_places(words, seed):
    places = place_map(words, list(range(len(words))))
    total = sum(words)
    hit = np.random.default_rng(seed).integers(max(total, 1), size=12 if total else 0)
    ballot = vote_for_places(hit, places, len(words))
    owner, distinct = np.repeat(np.arange(len(words)), words), set(hit.tolist())
    for place, count in enumerate(words):
        votes = sum(owner[word] == place for word in distinct)
        if total and votes > len(distinct) * count / total:
            at = ballot.places.tolist().index(place)
            assert ballot.log_density[at] == pytest.approx(binom.logpmf(votes, len(distinct), count / total))
        else:
            assert place not in ballot.places
