"""Whole recognisers on real images: what is accepted is true, and most of what can be found is."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from place_images import CachingSurf, Image, SecondCamera, kitti_images

from place_recognition.image_processing.local_features import FeatureCache
from place_recognition.paradigms.registry import make_control, make_recognizer
from place_recognition.recognizer import Belief

PARADIGMS = ["sequence-histograms", "dynamic-sequences", "hierarchical-places", "tracked-words"]
CLIPS = {"05": 60, "06": 51, "01": 51, "07": 160}  # frames of each; no clip revisits a place


@pytest.fixture(autouse=True, scope="module")
def _forget_features():
    yield
    CachingSurf.extracted.clear()


@pytest.fixture(params=PARADIGMS)
def paradigm(request):
    return request.param


def read_images(folder: Path, pattern: str, step: int = 1) -> list[Image]:
    paths = sorted(folder.glob(pattern), key=lambda path: (len(path.name), path.name))
    return [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in paths[::step]]


def recognize(paradigm: str, images: list[Image]) -> list[Belief]:
    features = FeatureCache(CachingSurf())
    recognizer = make_control(features) if paradigm == "control" else make_recognizer(paradigm, features)
    return [
        b for i, image in enumerate(images) for b in recognizer.observe(i, image, float("nan"))
    ] + recognizer.finish()


def accepted(beliefs: list[Belief]) -> list[tuple[int, int]]:
    return [(b.query, b.match) for b in beliefs if b.accepted]


def recall_at_100_precision(beliefs: list[Belief], is_true: Callable[[int, int], bool], rows: int) -> float:
    """Share of the revisits that are found before the first false match, by the score."""
    found = [(b.score, is_true(b.query, b.match)) for b in beliefs if b.match is not None]
    limit = max((score for score, right in found if not right), default=-np.inf)
    return sum(right and score > limit for score, right in found) / rows


@cache
def two_passes(root: Path, hard: int) -> tuple[list[Image], int]:
    """Even frames of all clips, a drive without revisits, then odd ones through another camera; length of the first."""
    frames = {name: kitti_images(root, name, range(count)) for name, count in CLIPS.items()}
    first = [image for images in frames.values() for image in images[::2]]
    second = [image for images in frames.values() for image in images[1::2]]
    camera = SecondCamera(hard, len(second))
    return first + [camera.view(k, image) for k, image in enumerate(second)], len(first)


@pytest.mark.parametrize(("hard", "min_recall"), [(3, 0.97), (5, 0.93)])
def test_a_second_pass_through_a_changed_camera_is_recognised(test_data, paradigm, hard, min_recall):
    images, first = two_passes(test_data, hard)
    beliefs = recognize(paradigm, images)
    begins = np.cumsum([0, *[(count + 1) // 2 for count in CLIPS.values()]])  # of the clips in the first pass
    ends = np.cumsum([0, *[count // 2 for count in CLIPS.values()]])

    def source(k: int) -> tuple[int, int]:
        """Clip and frame of an image."""
        starts = begins if k < first else ends + first
        clip = int(np.searchsorted(starts, k, side="right")) - 1
        return clip, 2 * (k - int(starts[clip])) + (k >= first)

    def is_true(query: int, match: int) -> bool:
        (clip, frame), (other, other_frame) = source(query), source(match)
        return query >= first > match and clip == other and abs(frame - other_frame) <= 10

    assert [pair for pair in accepted(beliefs) if not is_true(*pair)] == []
    assert len(accepted(beliefs)) >= min_recall * (len(images) - first)
    assert recall_at_100_precision(beliefs, is_true, len(images) - first) >= min_recall


@cache
def corridor(root: Path) -> list[Image]:
    return read_images(root / "corridor_two_laps", "*.jpg")


def is_same_place_of_the_corridor(query: int, match: int) -> bool:
    return min(abs(query - match - lap) for lap in (40, 80)) <= 2


def test_the_second_lap_through_a_corridor_is_recognised(test_data, paradigm):
    beliefs = recognize(paradigm, corridor(test_data))
    assert [pair for pair in accepted(beliefs) if not is_same_place_of_the_corridor(*pair)] == []
    assert recall_at_100_precision(beliefs, is_same_place_of_the_corridor, 44) >= 0.85


@cache
def gardens_point(root: Path) -> list[Image]:
    folder = root / "real_revisits" / "gardens_point"
    return [image for name in ("day_left", "day_right") for image in read_images(folder / name, "*.jpg")[:80]]


def test_a_path_is_recognised_from_its_other_side(test_data, paradigm):
    images = gardens_point(test_data)
    beliefs = recognize(paradigm, images)
    first = len(images) // 2

    def is_true(query: int, match: int) -> bool:
        return query >= first > match and abs(query - first - match) <= 3

    false = [pair for pair in accepted(beliefs) if not is_true(*pair)]
    assert len(false) <= 2
    assert all(abs(query - first - match) <= 8 for query, match in false)
    assert recall_at_100_precision(beliefs, is_true, first) >= 0.85


def test_a_walk_that_ends_where_it_began_is_recognised_there_and_nowhere_else(test_data, paradigm):
    folder = test_data / "real_revisits" / "library_stereo" / "sequences" / "00" / "image_0"
    pairs = accepted(recognize(paradigm, read_images(folder, "*.png", step=2)))
    assert len(pairs) >= 3
    assert all(query >= 155 and match <= 15 for query, match in pairs)


def test_in_a_room_seen_from_many_sides_no_match_is_false(test_data, paradigm):
    folder = test_data / "real_revisits" / "euroc_sparse"
    positions_m = np.loadtxt(folder / "truth_body.csv", delimiter=",", skiprows=1)[:, 2:5]
    for query, match in accepted(recognize(paradigm, read_images(folder / "cam0" / "data", "*.jpg"))):
        assert np.linalg.norm(positions_m[query] - positions_m[match]) < 3.0, (query, match)


def test_a_mirrored_second_pass_is_not_the_same_street(test_data, paradigm):
    images = kitti_images(test_data, "07", range(120))
    mirrored = [np.ascontiguousarray(image[:, ::-1]) for image in images[1::2]]
    assert accepted(recognize(paradigm, images[::2] + mirrored)) == []


def test_a_drive_without_revisits_has_none(test_data, paradigm):
    assert accepted(recognize(paradigm, kitti_images(test_data, "07", range(CLIPS["07"])))) == []


def test_random_candidates_are_worse_than_any_paradigm(test_data):
    images, first = two_passes(test_data, 5)
    assert len(accepted(recognize("control", images))) < 0.6 * (len(images) - first)
