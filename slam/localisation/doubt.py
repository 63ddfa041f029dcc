"""Why a pose that was found for an image is not to be believed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from odometry.camera import PinholeCamera
from place_recognition.image_processing.features import LocalFeatures
from slam.localisation.pose import CameraPose
from slam.localisation.saved_map import SavedMap

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DoubtConfig:
    """What a pose must show to be believed.

    Attributes:
        min_inliers: features of the image that agree with it.
        min_explained: share of the image's features that have one of those close by; the rest of the picture may be
            hidden by a bus, but where most of it is different, only a like building stands there.
        reach: how close, as a share of the image's width.
        max_sigma_m: standard deviation of its position, metres.
        max_rival: a place elsewhere may explain so many features of each that the best explains.
        elsewhere_m: how far that is, metres.
    """

    min_inliers: int = 30
    min_explained: float = 0.35
    reach: float = 0.05
    max_sigma_m: float = 0.3
    max_rival: float = 0.8
    elsewhere_m: float = 5.0


@dataclass(frozen=True)
class Hypothesis:
    """An image may have been taken here.

    Attributes:
        place: key frame beside which, counted in key frames.
        image: the same, by its number.
        agreeing: features of the image that agree, by number.
        pose: beside the key frame; None where there is none.
    """

    place: int
    image: int
    agreeing: NDArray[np.int64]
    pose: CameraPose | None

    def __len__(self) -> int:
        return len(self.agreeing)


def doubt(found: Hypothesis, features: LocalFeatures, camera: PinholeCamera, config: DoubtConfig) -> str:
    """Why not to believe a pose by itself, with the numbers; empty where there is no reason."""
    if found.pose is None:
        return "no pose stands out among the matches"
    if len(found) < config.min_inliers:
        return f"{len(found)} features agree with one pose, expected at least {config.min_inliers}"
    share = explained(features, found, config.reach * camera.width)
    if share < config.min_explained:
        return f"{share:.0%} of the picture is explained, expected at least {config.min_explained:.0%}"
    sigma = float(np.sqrt(np.trace(found.pose.covariance[3:, 3:])))
    if sigma > config.max_sigma_m:
        return f"the position is known to {sigma:.2f} m, expected {config.max_sigma_m} m"
    return ""


def explained(features: LocalFeatures, found: Hypothesis, reach_px: float) -> float:
    """Share of an image's features that lie near one that agrees."""
    nearest, _ = cKDTree(features.pixels[found.agreeing]).query(features.pixels)
    return float(np.mean(nearest < reach_px))


def rivalry(saved: SavedMap, hypotheses: Sequence[Hypothesis], config: DoubtConfig) -> str:
    """Whether another place explains the image nearly as well as the first; empty where none does."""
    best = hypotheses[0]
    for other in hypotheses[1:]:
        if len(other) >= config.max_rival * len(best) and _elsewhere(saved, best, other, config.elsewhere_m):
            return f"images {best.image} and {other.image} of the map explain it alike, and lie apart"
    return ""


def _elsewhere(saved: SavedMap, first: Hypothesis, second: Hypothesis, least_m: float) -> bool:
    if saved.world[first.image] != saved.world[second.image]:
        return False  # worlds that have not met may show one place
    positions = [_position(saved, one) for one in (first, second)]
    return bool(np.linalg.norm(positions[0] - positions[1]) > least_m)


def _position(saved: SavedMap, found: Hypothesis) -> Array:
    assert found.pose is not None  # it has agreeing features
    return np.asarray((saved.poses[found.image] @ found.pose.T_base_camera)[:3, 3])
