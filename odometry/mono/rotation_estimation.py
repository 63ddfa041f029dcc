"""Rotation of one camera between two images, where no parallax shows how far it moved.

While a camera turns on the spot, each ray of the second image is a ray of the first one, turned: the homography at
infinity (Hartley and Zisserman, Multiple View Geometry, section 13.4). The rotation is measured as well as ever then,
and the translation is known to be no larger than what the rays would show. docs/math.md, section "Rotation alone".
"""

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.distortion import LensDistortion
from odometry.mono.motion_only_bundle_adjustment import PoseEstimate

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_LIMIT = 18.4  # squared residual of an outlier, in variances: see `odometry.mono.motion_only_bundle_adjustment`
_QUANTILE, _AT_QUANTILE = 0.3, 0.713  # the same: most of the view may belong to something that moves
_MIN_NOISE_PX = 0.05
_PER_POINT, _OUTLIER = 1.39, 2.0  # of the criterion: log 4 an unknown depth, and the largest cost of a point
_ITERATIONS = 16  # of reweighting
_BEGIN = 8  # the first ones minimise the sum of absolute residuals, which needs no noise level and bears many outliers
_CONVERGED_RAD = 1e-6


def estimate_rotation(lens: LensDistortion, first: Array, second: Array, depth: float) -> PoseEstimate:
    """Estimate the rotation between pixels (N, 2), N > 2, of two images, taken to be of the same place.

    Args:
        lens: of the camera.
        first: (N, 2) pixels in the first image.
        second: (N, 2) pixels of the same points in the second one.
        depth: median depth of the scene, in the unit that the translation's uncertainty is wanted in.

    Returns:
        Translation zero, with the standard deviation of what the residuals may hide at this depth.
    """
    rays = _normalize(lens.rays(first)), _normalize(lens.rays(second))
    focal = lens.camera.fx
    weights, R, sigma = np.ones(len(first)), np.eye(3), 0.0
    for k in range(_ITERATIONS):
        before, R = R, _fit(*rays, weights)
        chi2 = _squared_residuals(*rays, R, focal)
        sigma = max(float(np.sqrt(np.quantile(chi2, _QUANTILE) / _AT_QUANTILE)), _MIN_NOISE_PX)
        if k < _BEGIN:
            weights = 1.0 / np.sqrt(chi2 + _MIN_NOISE_PX**2)
            continue
        weights = 1.0 / (1.0 + chi2 / (_LIMIT * sigma**2)) ** 2
        if np.abs(R - before).max() < _CONVERGED_RAD:
            break
    inliers = chi2 < _LIMIT * sigma**2
    residual = float(np.sqrt(chi2[inliers].mean() / 2))
    return PoseEstimate(
        se3.pose(R, np.zeros(3)), _covariance(rays[1][inliers], sigma / focal, depth), inliers, sigma, residual, chi2
    )


def explains_as_well(rotation: PoseEstimate, motion: PoseEstimate, noise_px: float, num_unknown: int) -> bool:
    """Whether a rotation explains the tracks as well as a motion that may also have a translation.

    The geometric robust information criterion (Torr, An assessment of information criteria for motion model selection,
    CVPR 1997): a motion has three unknowns more, and one more for each point of unknown depth.
    """
    count = len(rotation.chi2)
    allowed = _PER_POINT * num_unknown + 3 * np.log(4 * count)
    chi2 = (np.nan_to_num(found.chi2, nan=np.inf) / noise_px**2 for found in (rotation, motion))
    costs = [float(np.minimum(each, _OUTLIER).sum()) for each in chi2]
    return bool(costs[0] <= costs[1] + allowed)


def _fit(first: Array, second: Array, weights: Array) -> Array:
    """Rotation (3, 3) that turns directions `second` (N, 3) to `first` best (Kabsch, Acta Cryst. A32, 1976)."""
    U, _, Vt = np.linalg.svd((weights[:, None] * first).T @ second)
    return np.asarray(U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt)


def _squared_residuals(first: Array, second: Array, R: Array, focal: float) -> Array:
    """Squared angles (N,) between the rays, in pixels of the image's middle."""
    return np.asarray(focal**2 * np.sum(np.cross(first, second @ R.T) ** 2, axis=1))


def _covariance(rays: Array, sigma_rad: float, depth: float) -> Array:
    """Covariance (6, 6), rotation first.

    Parallax that looks like a rotation is not in the residuals, so the rotation is not more certain than a single ray.
    """
    covariance = np.zeros((6, 6))
    information = len(rays) * np.eye(3) - rays.T @ rays  # of the rotation, by directions across the rays
    covariance[:3, :3] = sigma_rad**2 * (np.linalg.inv(information + 1e-6 * np.eye(3)) + np.eye(3))
    covariance[3:, 3:] = (sigma_rad * depth) ** 2 * np.eye(3)
    return covariance


def _normalize(rays: Array) -> Array:
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))
