"""What is still in view is never matchable, whatever the speed and the frame rate, and what is past is."""

import copy

import numpy as np
import pytest
from landmark_street import NAN, LandmarkStreet, View, history_of, no_features, unrelated_features

from place_recognition.map.image_history import ImageHistory
from place_recognition.verification.present_view import CameraSteps, PresentView, PresentViewConfig

SPEED_M_PER_S = 10.0
VIEW_M = 28.0  # no landmark of the street is seen from further away
MAX_SHARED = 6  # landmarks that two images share by which nobody could take them for one view: seven fit any geometry
STREET = LandmarkStreet()


def drive(positions_m, hidden=(), blank=(), is_distance_measured=False, config=None):
    """Views of a drive and the latest matchable location of each; a lorry hides some, others are blank."""
    rng, history = np.random.default_rng(0), ImageHistory()
    view, views, matchable = PresentView(history, config), [], []
    for k, z_m in enumerate(positions_m):
        seen = STREET.view(z_m)
        if k in hidden or k in blank:
            features = unrelated_features(rng) if k in hidden else no_features()
            seen = View(features, np.empty(0, np.int64))
        history.add(k, seen.features, z_m if is_distance_measured else NAN)
        views.append(seen)
        matchable.append(view.advance())
    return views, matchable


def most_shared(views, matchable) -> int:
    """Largest number of landmarks of an image that are seen in an image with which it may be matched."""
    return max(
        len(np.intersect1d(views[k].landmarks, views[j].landmarks))
        for k, last in enumerate(matchable)
        for j in range(max(last - 80, 0), last + 1)
    )


def stop_of(images: int, at_m: float = 80.0, creep_m: float = 0.0):
    """A drive at ten images a second that stands, or crawls, for so many images."""
    there = at_m + creep_m * np.arange(images)
    return np.concatenate([np.arange(0, at_m), there, there[-1] + 1 + np.arange(60.0)])


@pytest.mark.parametrize("is_distance_measured", [False, True], ids=["no distance", "distance"])
@pytest.mark.parametrize("rate_hz", [1, 10, 20])
def test_nothing_in_view_is_matchable_at_any_frame_rate_and_the_past_is(rate_hz, is_distance_measured):
    positions_m = np.arange(0, 250 if rate_hz == 1 else 110, SPEED_M_PER_S / rate_hz)
    views, matchable = drive(positions_m, is_distance_measured=is_distance_measured)
    assert most_shared(views, matchable) <= MAX_SHARED
    behind_m = positions_m[-1] - positions_m[matchable[-1]]
    assert behind_m <= 2 * VIEW_M + 6 * SPEED_M_PER_S / rate_hz


@pytest.mark.parametrize("creep_m", [0.0, 0.05], ids=["standing", "crawling"])
def test_a_stop_is_no_past_and_ends_where_the_camera_has_left(creep_m):
    positions_m = stop_of(100, creep_m=creep_m)
    views, matchable = drive(positions_m)
    assert most_shared(views, matchable) <= MAX_SHARED
    assert max(matchable[80:180]) < 80
    assert matchable[-1] >= 160  # the reach falls by one image at a time


@pytest.mark.parametrize("images", [1, 2, 3, 5, 8, 12, 20])
def test_a_lorry_that_hides_the_view_does_not_make_it_past(images):
    hidden = range(50, 50 + images)
    views, matchable = drive(np.arange(0, 100.0), hidden=hidden)
    assert most_shared(views, matchable) <= MAX_SHARED
    assert matchable[-1] > 60


@pytest.mark.parametrize("begin", [3, 60], ids=["soon after the stop", "late"])
@pytest.mark.parametrize("images", [5, 20])
def test_nor_does_a_lorry_that_passes_a_standing_camera(images, begin):
    first = 80 + begin
    views, matchable = drive(stop_of(100), hidden=range(first, first + images))
    assert most_shared(views, matchable) <= MAX_SHARED


@pytest.mark.parametrize("images", [1, 5, 20])
def test_blank_images_do_not_end_the_view(images):
    views, matchable = drive(np.arange(0, 100.0), blank=range(50, 50 + images))
    assert most_shared(views, matchable) <= MAX_SHARED


def test_a_standing_camera_that_is_covered_for_long_still_sees_the_present():
    views, matchable = drive(stop_of(100), blank=range(95, 150))
    assert most_shared(views, matchable) <= MAX_SHARED


@pytest.mark.parametrize("is_noisy", [False, True])
def test_of_equal_images_none_is_matchable(is_noisy):
    one = STREET.view(50.0).features
    history = ImageHistory()
    view = PresentView(history)
    for k in range(500):
        history.add(k, STREET.view(50.0).features if is_noisy else one, NAN)
        assert view.advance() == -1


def test_the_smallest_distance_and_the_exclusion_hold_besides_the_view():
    positions_m = np.arange(0, 110.0)
    _, far = drive(positions_m, is_distance_measured=True, config=PresentViewConfig(min_distance_m=90.0))
    _, excluded = drive(positions_m, config=PresentViewConfig(exclusion_frames=85))
    _, plain = drive(positions_m)
    assert all(k - last >= 90 for k, last in enumerate(far) if last >= 0)
    assert all(k - last >= 85 for k, last in enumerate(excluded) if last >= 0)
    assert (far[-1], excluded[-1]) == (19, 24)
    assert plain[-1] > 70
    assert all(k - last >= PresentViewConfig().min_gap_frames for k, last in enumerate(plain) if last >= 0)


def test_a_restored_view_goes_on_where_it_was():
    positions_m, hidden = np.arange(0, 90.0), range(50, 56)
    views, matchable = drive(positions_m, hidden=hidden)
    for stop in (20, 53, 57):
        history, after = ImageHistory(), []
        one, other = PresentView(history), PresentView(history)
        for k, view in enumerate(views):
            if k == stop:
                other.restore(copy.deepcopy(one.state()))
            history.add(k, view.features, NAN)
            after.append((one if k < stop else other).advance())
        assert after == matchable


def steps_of(positions_m, hidden=()) -> CameraSteps:
    rng = np.random.default_rng(0)
    features = [unrelated_features(rng) if k in hidden else STREET.view(z).features for k, z in enumerate(positions_m)]
    steps = CameraSteps(history_of(features))
    for k in range(len(features)):
        steps.add(k)
    return steps


def test_a_moving_camera_takes_a_step_an_image_and_a_standing_one_takes_none():
    steps = steps_of(stop_of(100)[:240])
    assert [steps.of(k) for k in range(80)] == list(range(80))
    assert len(steps) == 80 + 1 + 60
    assert steps.images(80) == range(80, 180)
    assert [len(steps.images(k)) for k in (0, 79, 81)] == [1, 1, 1]


def test_a_crawling_camera_takes_fewer_steps_than_images():
    steps = steps_of(50 + 0.02 * np.arange(100))
    assert 3 <= len(steps) <= 50
    found = [image for k in range(len(steps)) for image in steps.images(k)]
    assert found == list(range(100))
    assert all({steps.of(image) for image in steps.images(k)} == {k} for k in range(len(steps)))


def test_at_half_the_frame_rate_a_moving_camera_takes_half_the_steps():
    assert len(steps_of(np.arange(0, 60, 1.0))) == 2 * len(steps_of(np.arange(0, 60, 2.0)))


def test_where_nothing_is_common_the_camera_has_moved():
    steps = steps_of(np.full(20, 50.0), hidden=(8, 9))
    assert len(steps) == 4  # before, two of the lorry, after


def test_restored_steps_go_on():
    positions_m = stop_of(30)[:130]
    whole, begun = steps_of(positions_m), steps_of(positions_m[:100])
    other = CameraSteps(history_of([STREET.view(z).features for z in positions_m]))
    other.restore(copy.deepcopy(begun.state()))
    for k in range(100, len(positions_m)):
        other.add(k)
    assert [other.of(k) for k in range(130)] == [whole.of(k) for k in range(130)]


def test_a_step_shows_a_place_of_its_own_until_it_is_recognised():
    steps = steps_of(np.concatenate([np.arange(30.0), np.full(5, 30.0), np.arange(31, 40.0)]))
    locations = np.arange(44)
    own = [steps.of(k) for k in range(44)]
    assert steps.places(locations).tolist() == own
    steps.recognize(30, 7)
    assert steps.places(locations).tolist() == [7 if step == 30 else step for step in own]
    assert [steps.of(k) for k in range(44)] == own


def test_passes_meet_where_a_recognised_step_follows_one_of_a_place_of_its_own_and_part_where_the_next_does():
    steps = steps_of(np.arange(40.0))
    assert steps.junctions().tolist() == []
    for step, place in ((30, 7), (31, 8), (32, 8), (33, 11)):
        steps.recognize(step, place)
    assert steps.junctions().tolist() == [[29, 7], [11, 34]]
