"""Ids and distances of images: what is far behind, and which location an id has."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from place_recognition.map.image_history import ImageTimeline

NAN = float("nan")
STEPS = st.lists(st.floats(0, 5).map(lambda step: round(step, 2)), min_size=1, max_size=30)


def timeline(distances_m: list[float], ids: list[int] | None = None) -> ImageTimeline:
    made = ImageTimeline()
    for image_id, distance_m in zip(ids or range(len(distances_m)), distances_m, strict=True):
        made.add(image_id, distance_m)
    return made


@given(STEPS, st.floats(0, 40))
def test_the_last_location_behind_is_the_last_one_at_that_distance(steps: list[float], min_distance_m: float):
    distances_m = np.cumsum([0.0, *steps]).tolist()
    made = timeline(distances_m)
    far = [k for k, distance_m in enumerate(distances_m) if distance_m <= distances_m[-1] - min_distance_m]
    expected = max(far, default=-1) if made.is_distance_measured else len(distances_m) - 1
    assert made.last_behind(min_distance_m) == expected


@pytest.mark.parametrize("distances_m", [[NAN, NAN, NAN], [7.0, 7.0, 7.0], [0.0]])
def test_without_a_measured_distance_every_location_is_far_enough(distances_m: list[float]):
    made = timeline(distances_m)
    assert not made.is_distance_measured
    assert made.last_behind(1000.0) == len(distances_m) - 1


@given(st.lists(st.integers(-1000, 1000), min_size=1, max_size=20, unique=True).map(sorted))
def test_an_id_has_the_location_at_which_it_was_added(ids: list[int]):
    made = timeline([0.0] * len(ids), ids)
    assert [made.find_location(image_id) for image_id in ids] == list(range(len(ids)))
    assert made.ids.tolist() == ids
    for absent in set(range(ids[0] - 1, ids[-1] + 2)) - set(ids):
        with pytest.raises(ValueError, match=f"expected the id of an image that was observed, got {absent}"):
            made.find_location(absent)


def test_ids_must_rise():
    made = timeline([0.0], [5])
    for image_id in (5, 4):
        with pytest.raises(ValueError, match=f"greater than 5, got {image_id}"):
            made.add(image_id, 1.0)
