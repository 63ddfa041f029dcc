"""An image between two sure revisits of one stretch of way is spoken for; nothing else changes."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from place_recognition.belief.bridge import Bridge, BridgeConfig
from place_recognition.image_processing.features import LocalFeatures
from place_recognition.map.route import ImageHistory
from place_recognition.recognizer import Belief


def features(count: int) -> LocalFeatures:
    pixels, ones = np.zeros((count, 2), np.float32), np.ones(count, np.float32)
    return LocalFeatures(pixels, ones, ones, np.full((count, 4), 0.5, np.float32))


def route(images: int, step: int = 1, blank: tuple[int, ...] = ()) -> ImageHistory:
    made = ImageHistory()
    for k in range(images):
        made.add(k * step, features(0 if k in blank else 20), float("nan"))
    return made


def sure(query: int, match: int) -> Belief:
    return Belief(query, match, 90.0 + query, accepted=True, inliers=80)


def unsure(query: int) -> Belief:
    return Belief(query, 3, 2.0, accepted=False, inliers=0, verified=False)


def settled(beliefs: list[Belief], step: int = 1, blank: tuple[int, ...] = ()) -> list[Belief]:
    bridge = Bridge(route(100, step, blank))
    return [b for belief in beliefs for b in bridge.add([belief])] + bridge.finish()


def test_an_image_between_two_sure_ones_gets_the_match_between_theirs():
    before, between, after = settled([sure(50, 10), unsure(51), sure(52, 12)])
    assert (before, after) == (sure(50, 10), sure(52, 12))
    assert between == Belief(51, 11, 140.0, accepted=False, inliers=0, verified=True)


def test_ids_with_gaps_are_bridged_to_ids_that_exist():
    assert settled([sure(150, 30), unsure(153), unsure(156), sure(159, 36)], step=3)[1].match == 33


def test_a_way_driven_backwards_is_bridged_too():
    assert [b.match for b in settled([sure(50, 20), unsure(51), unsure(52), sure(53, 17)])] == [20, 19, 18, 17]


@pytest.mark.parametrize(
    "beliefs",
    [
        [sure(50, 10), unsure(51), sure(52, 30)],
        [sure(50, 10), unsure(51), unsure(52), unsure(53), sure(54, 14)],
        [unsure(50), sure(51, 11), unsure(52)],
    ],
    ids=["two places", "a long gap", "no sure one on one side"],
)
def test_what_cannot_be_bridged_stays_as_it_is(beliefs):
    assert settled(beliefs) == beliefs


def test_an_image_that_shows_nothing_has_no_place():
    assert settled([sure(50, 10), unsure(51), sure(52, 12)], blank=(51,))[1] == unsure(51)


def test_an_image_that_shows_nothing_is_no_place():
    assert settled([sure(50, 10), unsure(51), sure(52, 12)], blank=(11,))[1].match == 10
    assert settled([sure(50, 10), unsure(51), sure(52, 12)], blank=(9, 10, 11, 12, 13))[1] == unsure(51)


def test_a_match_of_its_own_that_fits_is_kept():
    own = Belief(51, 12, 2.0, accepted=False, inliers=7, verified=False)
    assert settled([sure(50, 10), own, sure(52, 12)])[1].match == 12


def test_where_images_agree_goes_with_a_match_and_not_with_another():
    pixels = np.ones((7, 4), np.float32)
    own = Belief(51, 12, 2.0, accepted=False, inliers=7, pixels=pixels)
    assert settled([sure(50, 10), own, sure(52, 12)])[1].pixels is pixels
    moved = settled([sure(50, 10), replace(own, match=3), sure(52, 12)])[1]
    assert moved.match == 11
    assert len(moved.pixels) == 0


@given(st.lists(st.booleans(), max_size=40))
def test_every_belief_comes_out_once_in_order_and_at_most_a_few_late(surely):
    bridge, out = Bridge(route(100), BridgeConfig(longest=2)), []
    for k, one in enumerate(surely, start=50):
        out += bridge.add([sure(k, k - 50) if one else unsure(k)])
        assert len(out) >= k - 50 + 1 - 2
    out += bridge.finish()
    assert [b.query for b in out] == list(range(50, 50 + len(surely)))
    assert [b.accepted for b in out] == surely
