"""Acceptance tests for the pose of a single image: enough inliers, enough of the image explained, no rival place."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from place_recognition.image_processing.local_features import LocalFeatures
from slam.localization.absolute_pose import CameraPose
from slam.localization.keyframe_map import SavedMap

Array = NDArray[np.float64]


@dataclass(frozen=True)
class AcceptanceConfig:
    """When a pose is accepted.

    Attributes:
        min_inliers: minimum number of features of the image that agree with it.
        min_explained_fraction: minimum share of the image's features that lie near an inlier. A bus may hide the rest
            of the image; where most of it differs, another building of the same kind stands there.
        explained_radius_fraction: largest distance of a feature near an inlier, as a share of the image's width.
        max_sigma_m: maximum standard deviation of the position, metres.
        max_rival_ratio: maximum number of inliers of a pose at another place, as a share of those of the best pose.
        min_rival_distance_m: minimum distance of another place, metres.
    """

    min_inliers: int = 30
    min_explained_fraction: float = 0.35
    explained_radius_fraction: float = 0.05
    max_sigma_m: float = 0.3
    max_rival_ratio: float = 0.8
    min_rival_distance_m: float = 5.0


@dataclass(frozen=True)
class Hypothesis:
    """A place where an image may have been taken.

    Attributes:
        place: key frame near which it was taken, counted in key frames.
        image: number of that key frame's image.
        agreeing: indices of the features that agree with the pose.
        pose: pose relative to the key frame; None where there is none.
    """

    place: int
    image: int
    agreeing: NDArray[np.int64]
    pose: CameraPose | None

    def __len__(self) -> int:
        return len(self.agreeing)


def rejection_reason(
    best: Hypothesis, others: Sequence[Hypothesis], features: LocalFeatures, saved: SavedMap, config: AcceptanceConfig
) -> str | None:
    """Why the best hypothesis is rejected, with the numbers; None where it is accepted."""
    if best.pose is None:
        return "no pose stands out among the matches"
    if len(best) < config.min_inliers:
        return f"{len(best)} features agree with one pose, expected at least {config.min_inliers}"
    share = explained_fraction(features, best, config.explained_radius_fraction * saved.camera.width)
    if share < config.min_explained_fraction:
        return f"{share:.1%} of the picture is explained, expected at least {config.min_explained_fraction:.0%}"
    sigma = float(np.sqrt(np.trace(best.pose.covariance[3:, 3:])))
    if sigma > config.max_sigma_m:
        return f"the position is known to {sigma:.2f} m, expected {config.max_sigma_m} m"
    rival = next((other for other in others if is_ambiguous(saved, best, other, config)), None)
    if rival is not None:
        return f"image {rival.image} of the map explains {len(rival)} features elsewhere, this one {len(best)}"
    return None


def explained_fraction(features: LocalFeatures, best: Hypothesis, radius_px: float) -> float:
    """Share of an image's features that lie within a radius, pixels, of one that agrees."""
    nearest, _ = cKDTree(features.pixels[best.agreeing]).query(features.pixels)
    return float(np.mean(nearest < radius_px))


def is_ambiguous(saved: SavedMap, best: Hypothesis, other: Hypothesis, config: AcceptanceConfig) -> bool:
    """Whether another place explains the image nearly as well as the best; places of separate maps do not compete."""
    if best.pose is None or other.pose is None or saved.map_id[best.image] != saved.map_id[other.image]:
        return False
    first = saved.poses[best.image] @ best.pose.T_base_camera
    second = saved.poses[other.image] @ other.pose.T_base_camera
    apart = float(np.linalg.norm(first[:3, 3] - second[:3, 3]))
    return len(other) > config.max_rival_ratio * len(best) and apart > config.min_rival_distance_m
