"""What speaks against a pose: too little agrees, too little is explained, another place does as well."""

from dataclasses import replace

import numpy as np
import pytest

from odometry import se3
from place_recognition.image_processing.local_features import LocalFeatures
from slam.localization.absolute_pose import CameraPose
from slam.localization.keyframe_map import SavedMap
from slam.localization.pose_checks import AcceptanceConfig, Hypothesis, explained_fraction, rejection_reason

CONFIG = AcceptanceConfig()


@pytest.fixture
def features(saved: SavedMap) -> LocalFeatures:
    """A hundred of them, spread evenly over the image from left to right."""
    pixels = np.linspace([0, 50], [saved.camera.width - 1, 50], 100).astype(np.float32)
    ones = np.ones(100, np.float32)
    return LocalFeatures(pixels, ones, ones, np.ones((100, 64), np.float32))


def hypothesis(image: int, agreeing: range, sigma_m: float = 0.05, aside_m: float = 0.0) -> Hypothesis:
    T_base_camera = se3.pose(np.eye(3), np.array([aside_m, 0.0, 0.0]))
    covariance = np.diag(np.repeat([1e-6, sigma_m**2 / 3], 3))
    pose = CameraPose(T_base_camera, covariance, np.ones(len(agreeing), bool))
    return Hypothesis(image, image, np.array(agreeing), pose)


def test_a_pose_that_explains_the_image_is_accepted(saved: SavedMap, features: LocalFeatures) -> None:
    assert rejection_reason(hypothesis(3, range(100)), [], features, saved, CONFIG) is None


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (hypothesis(3, range(0, 100, 5)), "20 features agree"),
        (hypothesis(3, range(0, 30)), "% of the picture is explained"),
        (hypothesis(3, range(100), sigma_m=0.5), "known to 0.50 m"),
        (replace(hypothesis(3, range(100)), pose=None), "no pose"),
    ],
)
def test_the_reason_for_rejecting_a_pose_is_given(
    saved: SavedMap, features: LocalFeatures, found: Hypothesis, words: str
) -> None:
    assert words in rejection_reason(found, [], features, saved, CONFIG)


def test_a_rival_is_a_distant_place_that_explains_as_much(saved: SavedMap, features: LocalFeatures) -> None:
    best = hypothesis(3, range(100))
    beside, weak, strong = hypothesis(4, range(95)), hypothesis(30, range(40)), hypothesis(30, range(95))
    assert rejection_reason(best, [beside, weak], features, saved, CONFIG) is None
    assert "image 30 of the map explains 95 features elsewhere" in rejection_reason(
        best, [beside, strong], features, saved, CONFIG
    )
    worlds = np.arange(len(saved.map_id)) // 20  # two drives that have never met may show one street
    assert rejection_reason(best, [strong], features, replace(saved, map_id=worlds), CONFIG) is None
    moved = hypothesis(3, range(95), aside_m=2 * CONFIG.min_rival_distance_m)
    assert "elsewhere" in rejection_reason(best, [moved], features, saved, CONFIG)


def test_the_explained_fraction_counts_features_near_inliers(features: LocalFeatures) -> None:
    spacing = float(features.pixels[1, 0] - features.pixels[0, 0])
    assert explained_fraction(features, hypothesis(0, range(10, 11)), 2.5 * spacing) == pytest.approx(0.05)
    assert explained_fraction(features, hypothesis(0, range(0, 100, 5)), 2.5 * spacing) == pytest.approx(0.98)
