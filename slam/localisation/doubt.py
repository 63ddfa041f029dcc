"""Why a pose that was found for an image is not to be believed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

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


def doubt(
    best: Hypothesis, others: Sequence[Hypothesis], features: LocalFeatures, saved: SavedMap, config: DoubtConfig
) -> str:
    """Why not to believe the best hypothesis, with the numbers; empty where there is no reason."""
    if best.pose is None:
        return "no pose stands out among the matches"
    if len(best) < config.min_inliers:
        return f"{len(best)} features agree with one pose, expected at least {config.min_inliers}"
    share = explained(features, best, config.reach * saved.camera.width)
    if share < config.min_explained:
        return f"{share:.1%} of the picture is explained, expected at least {config.min_explained:.0%}"
    sigma = float(np.sqrt(np.trace(best.pose.covariance[3:, 3:])))
    if sigma > config.max_sigma_m:
        return f"the position is known to {sigma:.2f} m, expected {config.max_sigma_m} m"
    rival = next((other for other in others if rivals(saved, best, other, config)), None)
    if rival is not None:
        return f"image {rival.image} of the map explains {len(rival)} features elsewhere, this one {len(best)}"
    return ""


def explained(features: LocalFeatures, found: Hypothesis, reach_px: float) -> float:
    """Share of an image's features that lie near one that agrees."""
    nearest, _ = cKDTree(features.pixels[found.agreeing]).query(features.pixels)
    return float(np.mean(nearest < reach_px))


def rivals(saved: SavedMap, best: Hypothesis, other: Hypothesis, config: DoubtConfig) -> bool:
    """Whether another place explains the image nearly as well as the best, which worlds that have not met may."""
    if best.pose is None or other.pose is None or saved.map_id[best.image] != saved.map_id[other.image]:
        return False
    first = saved.poses[best.image] @ best.pose.T_base_camera
    second = saved.poses[other.image] @ other.pose.T_base_camera
    apart = float(np.linalg.norm(first[:3, 3] - second[:3, 3]))
    return len(other) > config.max_rival * len(best) and apart > config.elsewhere_m
