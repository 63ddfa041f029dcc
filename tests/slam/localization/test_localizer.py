"""An image of another lap is placed where it was taken; what the map does not show is not found.

Images that share words are alike; what all share does not count.
"""

from pathlib import Path

import numpy as np
import pytest

from odometry import se3
from place_recognition.image_processing.extractors import Sift
from place_recognition.image_processing.surf import Surf
from slam.datasets.formats.registry import open_dataset
from slam.errors import DataError
from slam.evaluation.trajectory_errors import umeyama
from slam.localization.keyframe_map import SavedMap
from slam.localization.localizer import IndexConfig, LocalizationResult, Localizer, NotLocalized, PlaceIndex

from .conftest import MAPPED

LAP = 160  # frames; a metre each
IMAGES, FEATURES = 12, 60


@pytest.fixture(scope="module")
def locator(saved: SavedMap) -> Localizer:
    return Localizer(saved, Surf())


def image(drive: Path, frame: int) -> np.ndarray:
    return open_dataset(drive)[frame].left


def test_images_of_the_next_lap_are_localized_where_they_were_taken(
    locator: Localizer, saved: SavedMap, circle_drive: Path, truth: np.ndarray
) -> None:
    fit = umeyama(saved.poses[:, :3, 3], truth[list(MAPPED), :3, 3])
    for frame in range(LAP + 5, LAP + 85, 11):
        found = locator.locate(image(circle_drive, frame))
        assert isinstance(found, LocalizationResult), (frame, found)
        T_camera_found = se3.inverse(truth[frame]) @ fit.apply_poses(found.T_world_camera[None])[0]
        assert np.linalg.norm(T_camera_found[:3, 3]) < 1.0  # as far as the map has drifted
        T_beside_found = se3.inverse(saved.poses[found.image]) @ found.T_world_camera
        T_beside_camera = se3.inverse(truth[MAPPED[found.image]]) @ truth[frame]
        error = se3.log(se3.inverse(T_beside_camera) @ T_beside_found)
        assert np.linalg.norm(error[3:]) < 0.1
        assert np.degrees(np.linalg.norm(error[:3])) < 0.3


def test_an_image_of_the_map_is_localized_at_its_own_pose(
    locator: Localizer, saved: SavedMap, circle_drive: Path
) -> None:
    found = locator.locate(image(circle_drive, MAPPED[20]))
    assert isinstance(found, LocalizationResult)
    T_there_found = se3.inverse(saved.poses[20]) @ found.T_world_camera
    assert np.linalg.norm(se3.log(T_there_found)) < 0.02


def test_places_outside_the_map_are_not_localized(locator: Localizer, circle_drive: Path) -> None:
    shape = image(circle_drive, 0).shape
    noise = np.random.default_rng(0).integers(0, 256, shape, np.uint8)
    strangers = [noise, np.zeros(shape, np.uint8), image(circle_drive, LAP + 5)[:, ::-1].copy()]
    strangers += [image(circle_drive, frame) for frame in (110, 120, 130)]
    for stranger in strangers:
        found = locator.locate(stranger)
        assert isinstance(found, NotLocalized)
        assert found.reason


def test_features_of_another_kind_are_refused(saved: SavedMap, circle_drive: Path) -> None:
    with pytest.raises(DataError, match="expected landmarks of sift"):
        Localizer(saved, Sift()).locate(image(circle_drive, 0))


def test_a_result_does_not_depend_on_earlier_images(locator: Localizer, saved: SavedMap, circle_drive: Path) -> None:
    asked = [locator.locate(image(circle_drive, frame)) for frame in (LAP + 20, LAP + 60)]
    anew = Localizer(saved, Surf()).locate(image(circle_drive, LAP + 60))
    assert isinstance(anew, LocalizationResult)
    assert isinstance(asked[1], LocalizationResult)
    assert np.array_equal(anew.T_world_camera, asked[1].T_world_camera)
    assert np.array_equal(anew.covariance, asked[1].covariance)


@pytest.fixture(scope="module")
def places() -> list[np.ndarray]:
    """Descriptors of images of different places; every image shows the first ten of them as well."""
    rng = np.random.default_rng(0)
    drawn = rng.normal(size=(IMAGES, FEATURES, 64)).astype(np.float32)
    drawn[:, :10] = drawn[0, :10]
    return list(drawn / np.linalg.norm(drawn, axis=2, keepdims=True))


@pytest.mark.parametrize("words", [100, 10000])
def test_each_place_is_most_similar_to_itself(places: list[np.ndarray], words: int) -> None:
    index = PlaceIndex.build(lambda: places, IndexConfig(words))
    rng = np.random.default_rng(1)
    for number, descriptors in enumerate(places):
        again = descriptors[rng.permutation(FEATURES)[:40]] + rng.normal(size=(40, 64)).astype(np.float32) * 0.01
        similarity = index.similarity(again)
        assert similarity.argmax() == number
        assert similarity.max() <= 1 + 1e-6


def test_words_that_every_place_shows_carry_no_information(places: list[np.ndarray]) -> None:
    index = PlaceIndex.build(lambda: places, IndexConfig())
    similarity = index.similarity(places[3][:10])
    assert np.ptp(similarity) < 0.05
    assert np.ptp(index.similarity(places[3])) > 0.5


def test_an_image_without_features_is_similar_to_no_place(places: list[np.ndarray]) -> None:
    empty = np.empty((0, 64), np.float32)
    index = PlaceIndex.build(lambda: [empty, *places], IndexConfig())
    assert not index.similarity(empty).any()
    assert index.similarity(places[0]).argmax() == 1
    assert np.isfinite(index.similarity(places[0])).all()
