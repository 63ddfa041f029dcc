"""Short gaps between accepted matches are filled with interpolated matches; nothing else changes."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from place_recognition.belief.temporal_consistency import GapFiller, GapFillerConfig
from place_recognition.image_processing.local_features import LocalFeatures
from place_recognition.map.image_history import ImageHistory
from place_recognition.recognizer import Belief


def features(count: int) -> LocalFeatures:
    pixels, ones = np.zeros((count, 2), np.float32), np.ones(count, np.float32)
    return LocalFeatures(pixels, ones, ones, np.full((count, 4), 0.5, np.float32))


def history(images: int, step: int = 1, blank: tuple[int, ...] = ()) -> ImageHistory:
    made = ImageHistory()
    for k in range(images):
        made.add(k * step, features(0 if k in blank else 20), float("nan"))
    return made


def accepted(query: int, match: int) -> Belief:
    return Belief(query, match, 90.0 + query, accepted=True, inliers=80)


def rejected(query: int) -> Belief:
    return Belief(query, 3, 2.0, accepted=False, inliers=0, verified=False)


def fill(beliefs: list[Belief], step: int = 1, blank: tuple[int, ...] = ()) -> list[Belief]:
    filler = GapFiller(history(100, step, blank))
    return [b for belief in beliefs for b in filler.add([belief])] + filler.finish()


def test_an_image_between_two_accepted_ones_gets_the_interpolated_match():
    before, between, after = fill([accepted(50, 10), rejected(51), accepted(52, 12)])
    assert (before, after) == (accepted(50, 10), accepted(52, 12))
    assert between == Belief(51, 11, 140.0, accepted=False, inliers=0, verified=True)


def test_a_filled_match_has_an_id_that_exists_where_ids_have_gaps():
    assert fill([accepted(150, 30), rejected(153), rejected(156), accepted(159, 36)], step=3)[1].match == 33


def test_a_revisit_in_the_opposite_direction_is_filled_too():
    assert [b.match for b in fill([accepted(50, 20), rejected(51), rejected(52), accepted(53, 17)])] == [20, 19, 18, 17]


@pytest.mark.parametrize(
    "beliefs",
    [
        [accepted(50, 10), rejected(51), accepted(52, 30)],
        [accepted(50, 10), rejected(51), rejected(52), rejected(53), accepted(54, 14)],
        [rejected(50), accepted(51, 11), rejected(52)],
    ],
    ids=["two places", "a long gap", "no accepted one on one side"],
)
def test_beliefs_around_a_gap_that_cannot_be_filled_stay_as_they_are(beliefs):
    assert fill(beliefs) == beliefs


def test_a_blank_query_gets_no_match():
    assert fill([accepted(50, 10), rejected(51), accepted(52, 12)], blank=(51,))[1] == rejected(51)


def test_a_blank_image_is_no_match():
    assert fill([accepted(50, 10), rejected(51), accepted(52, 12)], blank=(11,))[1].match == 10
    assert fill([accepted(50, 10), rejected(51), accepted(52, 12)], blank=(9, 10, 11, 12, 13))[1] == rejected(51)


def test_a_match_of_its_own_that_fits_is_kept():
    own = Belief(51, 12, 2.0, accepted=False, inliers=7, verified=False)
    assert fill([accepted(50, 10), own, accepted(52, 12)])[1].match == 12


def test_pixels_are_kept_with_their_own_match_and_dropped_with_another():
    pixels = np.ones((7, 4), np.float32)
    own = Belief(51, 12, 2.0, accepted=False, inliers=7, pixels=pixels)
    assert fill([accepted(50, 10), own, accepted(52, 12)])[1].pixels is pixels
    moved = fill([accepted(50, 10), replace(own, match=3), accepted(52, 12)])[1]
    assert moved.match == 11
    assert len(moved.pixels) == 0


@given(st.lists(st.booleans(), max_size=40))
def test_every_belief_is_returned_once_in_order_and_at_most_two_images_late(is_accepted):
    filler, out = GapFiller(history(100), GapFillerConfig(max_gap_images=2)), []
    for k, one in enumerate(is_accepted, start=50):
        out += filler.add([accepted(k, k - 50) if one else rejected(k)])
        assert len(out) >= k - 50 + 1 - 2
    out += filler.finish()
    assert [b.query for b in out] == list(range(50, 50 + len(is_accepted)))
    assert [b.accepted for b in out] == is_accepted
