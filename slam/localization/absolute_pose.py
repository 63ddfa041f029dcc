"""Absolute pose of one camera from 2D-3D matches with a map, and its covariance.

Errors are measured in the image, pixels: noise of the pixel plus the projected noise of the map's point.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.camera import PinholeCamera
from slam.loop_closing.relative_pose import MIN_LANDMARKS, pnp_ransac

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_MEDIAN_2 = 1.386  # median of chi-square, 2 degrees of freedom
_LIMIT_2 = 13.82  # its 99.9 % quantile
_MAX_ITERATIONS = 15  # of reweighted least squares
_CONVERGED = 1e-5  # rad and m: a smaller step ends the iteration
_MIN_DEPTH_M = 0.3  # closer points are not used
_FINAL_ITERATIONS = 2  # of plain least squares on the inliers


@dataclass(frozen=True)
class PoseConfig:
    """Noise model of the matches, and settings of RANSAC.

    Attributes:
        ransac_error_px: maximum reprojection error of an inlier of RANSAC, pixels.
        ransac_iterations: number of samples; enough for 20 % inliers and 4 points with probability 0.98.
        sigma_px: standard deviation of a pixel, pixels.
        systematic_rad: standard deviation of a rotation error that more points do not average out (calibration),
            radians.
        systematic_m: standard deviation of such an error of the translation, metres.
    """

    ransac_error_px: float = 4.0
    ransac_iterations: int = 2500
    sigma_px: float = 0.7
    systematic_rad: float = 5e-4
    systematic_m: float = 0.02


@dataclass(frozen=True)
class MapMatches:
    """2D-3D matches: pixels of an image, and the points of the map that they may show.

    Attributes:
        pixels: (K, 2) pixels in the image.
        points_base: (K, 3) points in the frame of a base camera.
        noise_base: (K, 3, 3) covariance of the points.
        features: (K,) index of the feature; one feature may match several key frames.
    """

    pixels: Array
    points_base: Array
    noise_base: Array
    features: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.pixels)

    def only(self, chosen: Mask) -> "MapMatches":
        """The matches chosen by a mask (K,)."""
        return MapMatches(self.pixels[chosen], self.points_base[chosen], self.noise_base[chosen], self.features[chosen])


@dataclass(frozen=True)
class CameraPose:
    """Pose of a camera relative to a base camera of the map.

    Attributes:
        T_base_camera: (4, 4) pose in the frame of the base camera.
        covariance: (6, 6) covariance of its right perturbation, rotation first.
        inliers: (K,) bool, matches that agree.
    """

    T_base_camera: Array
    covariance: Array
    inliers: Mask


def estimate_camera_pose(camera: PinholeCamera, matches: MapMatches, config: PoseConfig) -> CameraPose | None:
    """Pose of a camera by RANSAC and refinement; None without consensus."""
    start = pnp_ransac(camera, matches.points_base, matches.pixels, config.ransac_error_px, config.ransac_iterations)
    return None if start is None else refine_pose(camera, matches, start, config)


def refine_pose(
    camera: PinholeCamera, matches: MapMatches, T_base_camera: Array, config: PoseConfig
) -> CameraPose | None:
    """Refine a pose (4, 4): iteratively reweighted least squares, then plain least squares on the inliers.

    The plain steps make the covariance consistent: the weights only chose the inliers.
    """
    if len(matches) < MIN_LANDMARKS:
        return None
    system = _ReprojectionSystem(camera, matches, config)
    for _ in range(_MAX_ITERATIONS):
        chi2 = system.linearize(T_base_camera)
        step = system.step(1.0 / (1.0 + chi2))  # Cauchy's weights
        T_base_camera = T_base_camera @ se3.exp(step)
        if np.abs(step).max() < _CONVERGED:
            break
    chi2 = system.linearize(T_base_camera)
    # The median gives the noise level; where most matches are wrong it gives none, hence the bounds.
    inliers = chi2 < _LIMIT_2 * np.clip(np.median(chi2) / _MEDIAN_2, 1.0, 4.0)
    if np.sum(inliers) < MIN_LANDMARKS:
        return None
    weights = inliers * _feature_weights(matches.features, inliers)
    for _ in range(_FINAL_ITERATIONS):
        T_base_camera = T_base_camera @ se3.exp(system.step(weights))
        chi2 = system.linearize(T_base_camera)
    if not np.isfinite(chi2[inliers]).all():
        return None  # the last steps have diverged
    variance = float(chi2[inliers] @ weights[inliers]) / max(2 * float(weights.sum()) - 6, 1.0)
    systematic = np.repeat(np.square([config.systematic_rad, config.systematic_m]), 3)
    covariance = max(variance, 1.0) * np.linalg.pinv(system.information(weights)) + np.diag(systematic)
    if not (np.isfinite(T_base_camera).all() and np.isfinite(covariance).all()):
        return None
    return CameraPose(se3.orthonormalize(T_base_camera), np.asarray(covariance, np.float64), inliers)


def _feature_weights(features: NDArray[np.int64], inliers: Mask) -> Array:
    """Weight (K,) of each match: one over the number of inliers of its feature, which was measured only once."""
    counts = np.bincount(features, inliers, int(features.max()) + 1)
    return 1.0 / np.maximum(counts[features], 1.0)


class _ReprojectionSystem:
    """Whitened reprojection errors of matches and their Jacobians."""

    def __init__(self, camera: PinholeCamera, matches: MapMatches, config: PoseConfig) -> None:
        self._camera, self._matches = camera, matches
        self._noise = config.sigma_px**2 * np.eye(2)

    def linearize(self, T_base_camera: Array) -> Array:
        """Errors and Jacobians at a pose; returns chi-square (K,), infinite for points behind the camera."""
        points = se3.transform(se3.inverse(T_base_camera), self._matches.points_base)
        ahead = points[:, 2] > _MIN_DEPTH_M
        points[~ahead] = [0.0, 0.0, _MIN_DEPTH_M]  # any visible point: its weight is zero
        pixels, J = _project(self._camera, points)
        rotated = J @ T_base_camera[:3, :3].T
        covariance = self._noise + rotated @ self._matches.noise_base @ np.swapaxes(rotated, 1, 2)
        whiten = np.linalg.inv(np.linalg.cholesky(covariance))
        whiten[~ahead] = 0.0
        self._error = (whiten @ (self._matches.pixels - pixels)[:, :, None])[:, :, 0]
        # T exp(xi) moves a point X of the camera's frame by X x w - v
        motion = np.concatenate([se3.skew(points), np.tile(-np.eye(3), (len(J), 1, 1))], axis=2)
        self._jacobian = whiten @ J @ motion
        return np.where(ahead, np.sum(self._error**2, axis=1), np.inf)

    def information(self, weights: Array) -> Array:
        """Information (6, 6) of the matches under weights (K,)."""
        J = self._jacobian.reshape(-1, 6)
        return np.asarray((J * np.repeat(weights, 2)[:, None]).T @ J)

    def step(self, weights: Array) -> Array:
        """Gauss-Newton step (6,) under weights (K,), at the pose of the last `linearize`."""
        right = self._jacobian.reshape(-1, 6).T @ (self._error * weights[:, None]).ravel()
        return np.asarray(np.linalg.lstsq(self.information(weights), right, rcond=None)[0])


def _project(camera: PinholeCamera, points: Array) -> tuple[Array, Array]:
    """Pixels (K, 2) of points (K, 3), and their derivative (K, 2, 3)."""
    x, y, z = points.T
    pixels = np.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], axis=1)
    J = np.zeros((len(points), 2, 3))
    J[:, 0, 0], J[:, 0, 2] = camera.fx / z, -camera.fx * x / z**2
    J[:, 1, 1], J[:, 1, 2] = camera.fy / z, -camera.fy * y / z**2
    return pixels, J
