"""An image of another lap is placed where it was taken; what the map does not show is not found."""

from pathlib import Path

import numpy as np
import pytest

from odometry import se3
from place_recognition.image_processing.orb_and_sift import Sift
from place_recognition.image_processing.surf import Surf
from slam.datasets.formats.registry import open_dataset
from slam.errors import DataError
from slam.evaluation.trajectory_errors import umeyama
from slam.localization.keyframe_map import SavedMap
from slam.localization.localizer import LocalizationResult, Localizer, NotLocalized

from .conftest import MAPPED

LAP = 160  # frames; a metre each


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
