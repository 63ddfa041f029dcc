"""Initialization of a monocular map: motion between two images, up to scale, by the essential matrix.

What was tried and why these thresholds: docs/decisions/mono_initialization.md.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.camera import triangulate
from odometry.distortion import LensDistortion
from odometry.mono.mono_bundle_adjustment import MonoBundle
from odometry.mono.mono_frontend import MonoTracks
from odometry.mono.rotation_estimation import estimate_rotation

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_AGREEMENT_PX = 1.0  # epipolar error of a point that agrees; what is left of the distortion must fit
_ROUNDS = 1000  # samples at most
MIN_NOISE_PX = 0.2  # noise level of tracks that is assumed at least where parallax is looked for
# Median parallax that no rotation explains: an essential matrix of a turn has a wrong rotation and looks like parallax.
_MIN_UNEXPLAINED_PX = 4.0 * MIN_NOISE_PX
_MIN_SCALE_POINTS = 8  # points of known depth that carry the scale on to new ones
_NO_DEPTH = "the camera has not moved far enough to see depth"


@dataclass(frozen=True)
class InitializationConfig:
    """Thresholds for beginning a map with two images.

    Attributes:
        min_points: points that must agree on one motion.
        min_inlier_ratio: share of all points that must agree.
        min_parallax_rad: smallest median angle between the rays to one point.
    """

    min_points: int = 50
    min_inlier_ratio: float = 0.5
    min_parallax_rad: float = 0.01


@dataclass(frozen=True)
class Initialization:
    """Pose of a second camera relative to the first, up to scale.

    Attributes:
        T_first_second: (4, 4), in units of the distance between the two.
        inliers: (N,) bool, the points that agree.
    """

    T_first_second: Array
    inliers: Mask


@dataclass(frozen=True)
class NewDepths:
    """Motion since the last reference frame, to where depths are found anew.

    Attributes:
        T_first_second: (4, 4), in the unit of the map.
        inliers: (N,) bool, the points that agree.
        is_scale_known: whether points of known depth gave the scale; else it is a guess.
    """

    T_first_second: Array
    inliers: Mask
    is_scale_known: bool


def initialize(lens: LensDistortion, first: Array, second: Array, config: InitializationConfig) -> Initialization | str:
    """Find the motion between pixels (N, 2) of one image and of another, or return the reason why there is none.

    The five-point essential matrix also finds the motion in front of a plane. Where the camera only turned there is no
    parallax.
    """
    if len(first) < config.min_points:
        return f"fewer than {config.min_points} points could be followed"
    rays = lens.rays(first), lens.rays(second)
    if float(np.median(_angles(*rays))) < config.min_parallax_rad:
        return _NO_DEPTH
    found = _essential(*rays, lens.camera.fx)
    if found is None:
        return "no motion stands out among the points"
    T, inliers = found
    if inliers.sum() < max(config.min_points, config.min_inlier_ratio * len(first)):
        return f"only {inliers.sum()} of {len(first)} points agree on one motion"
    turned = estimate_rotation(lens, first[inliers], second[inliers], 1.0)
    if float(np.sqrt(np.median(turned.chi2))) < _MIN_UNEXPLAINED_PX:
        return _NO_DEPTH
    parallax = float(np.median(_angles(rays[0][inliers], rays[1][inliers] @ T[:3, :3].T)))
    if parallax < config.min_parallax_rad:
        return _NO_DEPTH
    return Initialization(T, inliers)


def find_depths(bundle: MonoBundle, tracks: MonoTracks, config: InitializationConfig) -> NewDepths | str:
    """Find depths anew by the parallax since the last reference frame, or return the reason why not.

    The camera has turned to where no depth is known. The scale of its first step comes from the points of known depth
    that are left, else the median depth of what it sees stays as it was.
    """
    found = initialize(bundle.lens, tracks.reference_pixels, tracks.pixels, config)
    if isinstance(found, str):
        return found
    scale, is_known = _carry_scale(bundle, tracks.select(found.inliers), found.T_first_second)
    T = found.T_first_second.copy()
    T[:3, 3] *= scale
    return NewDepths(T, found.inliers, is_known)


def _carry_scale(bundle: MonoBundle, tracks: MonoTracks, T_first_second: Array) -> tuple[float, bool]:
    """Scale of a motion of unit length, by points of known depth, else by the median depth; whether by points."""
    rays = bundle.lens.rays(tracks.reference_pixels), bundle.lens.rays(tracks.pixels)
    seen, _ = triangulate(*rays, se3.inverse(T_first_second))
    known = bundle.in_camera(tracks.ids, bundle.poses[-1])
    depth = known[:, 3] / np.maximum(known[:, 2], 1e-9)
    sure = bundle.points.select(tracks.ids).is_sure(bundle.noise_px) & (depth > 0) & (seen > 0)
    if sure.sum() >= _MIN_SCALE_POINTS:
        return float(np.median(seen[sure] / depth[sure])), True
    return float(np.median(seen[seen > 0])) / bundle.points.median_inverse_depth, False


def _essential(first: Array, second: Array, focal: float) -> tuple[Array, Mask] | None:
    """T_first_second (4, 4) of unit length and the points (N,) in front of both cameras."""
    K = np.diag([focal, focal, 1.0])
    pixels = focal * first[:, :2], focal * second[:, :2]
    E, mask = cv2.findEssentialMat(
        *pixels, K, method=cv2.USAC_MAGSAC, prob=0.9999, threshold=_AGREEMENT_PX, maxIters=_ROUNDS
    )
    if E is None or E.shape != (3, 3):
        return None
    _, R, t, good, _ = cv2.recoverPose(E, *pixels, K, distanceThresh=1e4, mask=mask)
    T = se3.inverse(se3.pose(R, t.ravel()))
    depth, _ = triangulate(first, second, se3.inverse(T))
    return T, (good.ravel() > 0) & (depth > 0)


def _angles(first: Array, second: Array) -> Array:
    """Angles (N,) between directions (N, 3), radians."""
    cross = np.linalg.norm(np.cross(first, second), axis=1)
    return np.arctan2(cross, np.sum(first * second, axis=1))
