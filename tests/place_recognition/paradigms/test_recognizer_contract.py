"""The contract of every recogniser. A new paradigm joins by its line in the registry."""

import numpy as np
import pytest
from place_images import CachingSurf, two_laps

from place_recognition.belief.place_filter import PlaceFilterConfig
from place_recognition.image_processing.local_features import FeatureCache
from place_recognition.paradigms.registry import PARADIGMS, ParadigmsConfig, make_control, make_recognizer
from place_recognition.recognizer import MAX_STAGE_CANDIDATES, Belief

STEP = 2.0  # metres from image to image


def drive(recognizer, images, first_id=0, id_step=1):
    """Beliefs of a whole drive."""
    beliefs: list[Belief] = []
    for i, image in enumerate(images):
        beliefs += recognizer.observe(first_id + i * id_step, image, STEP * i)
    return beliefs + recognizer.finish()


@pytest.fixture(scope="module", params=PARADIGMS)
def make(request):
    """Makes a recogniser that has seen nothing."""
    return lambda: make_recognizer(request.param, FeatureCache(CachingSurf()))


@pytest.fixture(scope="module")
def images():
    """Two laps of forty images along one path."""
    return two_laps()


@pytest.fixture(scope="module")
def expected(make, images):
    """The beliefs about two laps."""
    return drive(make(), images)


def test_every_image_gets_one_belief_in_order(expected, images):
    assert [b.query for b in expected] == list(range(len(images)))


def test_ids_may_start_anywhere_and_leave_gaps(make, images, expected):
    beliefs = drive(make(), images, first_id=100, id_step=5)
    assert [b.query for b in beliefs] == [100 + 5 * b.query for b in expected]
    assert [b.match for b in beliefs] == [None if b.match is None else 100 + 5 * b.match for b in expected]


def test_matches_are_earlier_images_outside_the_latest_ones(expected):
    matched = [b for b in expected if b.match is not None]
    assert all(0 <= b.match < b.query - 2 for b in matched)


def test_a_belief_without_a_match_is_not_accepted_and_has_no_probability(expected):
    unmatched = [b for b in expected if b.match is None]
    assert unmatched
    assert all(not b.accepted and b.probability == 0 and not b.inliers for b in unmatched)


def test_a_belief_is_answered_in_time_and_says_when(expected, images):
    """The lag of the decision, two sequences of at most twenty images, and their verification, two at a time."""
    lag = PlaceFilterConfig().lag_frames
    assert all(b.query <= b.answered_at <= min(b.query + lag + 20 + 20 + 10, len(images) - 1) for b in expected)
    assert [b.answered_at for b in expected] == sorted(b.answered_at for b in expected)


def test_a_belief_holds_what_each_stage_answers(expected):
    lap = len(expected) // 2
    for belief in expected:
        stages = belief.stages
        assert len(stages.candidates) <= MAX_STAGE_CANDIDATES
        assert (stages.own_score is None) == (not stages.candidates)
        assert all(candidate < belief.query for candidate in stages.candidates)
        assert (stages.geometry_match is None) == (stages.geometry_score is None)
    assert np.mean([b.stages.geometry_match == b.query - lap for b in expected[lap:]]) > 0.9


def test_what_is_accepted_is_probable_and_verified(expected):
    for belief in expected:
        assert 0.0 <= belief.probability <= 1.0
        assert not belief.accepted or (belief.verified and belief.probability >= PlaceFilterConfig().min_probability)


def test_the_first_lap_is_not_taken_for_a_revisit_and_the_second_is(expected):
    lap = len(expected) // 2
    assert not any(b.accepted for b in expected[:lap])
    assert sum(b.accepted and b.match == b.query - lap for b in expected[lap:]) > 0.8 * lap


@pytest.mark.parametrize("seed", range(3))
def test_random_candidates_are_clearly_worse_than_any_paradigm(images, seed):
    beliefs = drive(make_control(FeatureCache(CachingSurf()), ParadigmsConfig(seed=seed)), images)
    lap = len(beliefs) // 2
    assert sum(b.accepted and b.match == b.query - lap for b in beliefs[lap:]) < 0.5 * lap


def test_two_runs_give_the_same_beliefs(make, images, expected):
    again = drive(make(), images)
    assert again == expected
    assert all(np.array_equal(one.pixels, other.pixels) for one, other in zip(again, expected, strict=True))


def test_a_verified_match_has_the_pixels_of_its_inliers(expected):
    lap = len(expected) // 2
    assert all(len(b.pixels) == (b.inliers or 0) for b in expected)
    seen_again = [b.pixels for b in expected if b.accepted and b.match == b.query - lap]
    assert all(len(pixels) > 0 for pixels in seen_again)
    assert all(np.median(np.abs(pixels[:, :2] - pixels[:, 2:])) == 0 for pixels in seen_again)  # the very same image


def test_beliefs_do_not_depend_on_later_images(make, images, expected):
    recognizer = make()
    begun = [b for i, image in enumerate(images[:60]) for b in recognizer.observe(i, image, STEP * i)]
    assert begun == expected[: len(begun)]


def test_images_are_not_changed_and_may_be_overwritten_afterwards(make, images, expected):
    recognizer, beliefs = make(), []
    buffer = np.empty_like(images[0])
    for i, image in enumerate(images):
        buffer[:] = image
        beliefs += recognizer.observe(i, buffer, STEP * i)
        np.testing.assert_array_equal(buffer, image)
    assert beliefs + recognizer.finish() == expected


def test_black_images_match_nothing_and_the_others_are_still_recognised(make, images):
    changed = list(images)
    for k in (0, 20, 21, 60):
        changed[k] = np.zeros_like(changed[k])
    beliefs = drive(make(), changed)
    assert not any(beliefs[k].accepted for k in (0, 20, 21, 60))
    assert sum(b.accepted for b in beliefs[65:]) > 5


def test_a_drive_of_black_images_matches_nothing(make):
    beliefs = drive(make(), [np.zeros((240, 320), np.uint8)] * 50)
    assert not any(b.accepted for b in beliefs)


def test_images_may_change_their_size(make, images):
    cut = [image if i % 30 < 25 else image[:200, :300] for i, image in enumerate(images)]
    cut[33] = cut[33][:3, :5]
    assert len(drive(make(), cut)) == len(images)


@pytest.mark.parametrize("distance_m", [0.0, float("nan")], ids=["no distance measured", "distance unknown"])
def test_standing_still_is_no_revisit(make, images, distance_m):
    rng, recognizer, beliefs, lap = np.random.default_rng(0), make(), [], images[:40]
    for i, image in enumerate(lap[:20] + 60 * [lap[20]] + lap[21:]):
        noisy = np.clip(image + rng.normal(0, 2, image.shape), 0, 255).astype(np.uint8)
        beliefs += recognizer.observe(i, noisy, distance_m)
    assert not any(b.accepted for b in beliefs + recognizer.finish())


def test_ids_that_do_not_increase_are_refused(make, images):
    recognizer = make()
    recognizer.observe(4, images[0], 0.0)
    with pytest.raises(ValueError, match="expected an image id greater than 4, got 4"):
        recognizer.observe(4, images[1], 0.0)


@pytest.mark.parametrize("image", [np.zeros((60, 80, 2), np.uint8), np.zeros((60, 80)), np.zeros(60, np.uint8)])
def test_what_is_no_image_is_refused(make, image):
    with pytest.raises(ValueError, match="expected an image"):
        make().observe(0, image, 0.0)


def test_an_image_in_colour_counts_as_its_grey_image_where_no_colour_is_seen(make, images):
    grey, colour = make(), make()
    for index, image in enumerate(images[:3]):
        expected = grey.observe(index, image, 0.0)
        assert colour.observe(index, np.repeat(image[:, :, None], 3, axis=2), 0.0) == expected
