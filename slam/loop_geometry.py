"""The relative pose of two stereo images from landmarks that both have seen, and how sure it is.

Errors live in stereo pixels: (u, v) of the left image and the disparity d, each with its own noise, in both
images.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.camera import PinholeCamera, StereoCamera

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_MEDIAN_3 = 2.366  # median of chi-square, 3 degrees of freedom
_LIMIT_3 = 16.27  # its 99.9 % quantile
_MAD_TO_SIGMA = 1.4826  # of Gauss
MIN_LANDMARKS = 6  # below this a pose has nothing to be checked against
_ROUNDS = 15  # of reweighting at most
_SETTLED = 1e-5  # rad and m: a step below this ends it
_POLISH = 2  # steps of plain least squares on the inliers


@dataclass(frozen=True)
class GeometryConfig:
    """What landmark matches are expected to look like."""

    ransac_error_px: float = 3.0  # reprojection error of an inlier of the first guess
    ransac_iterations: int = 1000  # enough for 25 % inliers and 4 points at 0.98
    sigma_px: float = 0.5  # noise of a landmark's pixel, relative weight and lower bound of what is measured
    sigma_disparity_px: float = 0.5  # likewise of its disparity
    # Errors that more landmarks do not average out (calibration, rectification), one standard deviation:
    systematic_rad: float = 5e-4  # of rotation, radians
    systematic_rad_per_m: float = 4e-4  # and for each metre between the cameras
    systematic_m: float = 0.005  # of translation, metres
    systematic_m_per_m: float = 0.01  # and for each metre between the cameras
    systematic_unit: float = 0.01  # of the logarithm of a unit
    systematic_disparity_px: float = 0.2  # of all disparities alike; what it does depends on how far landmarks are

    def systematic(self, T_a_b: Array) -> Array:
        """Covariance (6, 6), rotation first, of these errors in a pose (4, 4)."""
        way = float(np.linalg.norm(T_a_b[:3, 3]))
        rotation = self.systematic_rad + self.systematic_rad_per_m * way
        translation = self.systematic_m + self.systematic_m_per_m * way
        return np.diag(np.repeat([rotation**2, translation**2], 3))


@dataclass(frozen=True)
class Unit:
    """How long one unit of length is in another.

    Attributes:
        log: natural logarithm of that.
        sigma: its standard deviation; 0 where it is known.
    """

    log: float
    sigma: float

    @property
    def length(self) -> float:
        """Of one in the other."""
        return float(np.exp(self.log))


SAME_UNIT = Unit(0.0, 0.0)


@dataclass(frozen=True)
class RelativePose:
    """A pose that landmarks agree on.

    Attributes:
        T_a_b: (4, 4) camera b in the frame of camera a, metres.
        covariance: (6, 6) of its right perturbation, rotation first: noise as measured, and systematic.
        inliers: (K,) bool over the matched landmarks.
        noise: of the inliers, as a multiple of the expected one.
    """

    T_a_b: Array
    covariance: Array
    inliers: Mask
    noise: float


def relative_pose(
    camera: StereoCamera, points_a: Array, points_b: Array, config: GeometryConfig
) -> RelativePose | None:
    """Pose of camera b in frame a from matched landmarks (K, 3), each in its own camera's frame, metres.

    PnP RANSAC of a's landmarks in b's image, refined on the stereo pixels of both; None without consensus.
    """
    start = _ransac(camera, points_a, points_b, config)
    return None if start is None else _refined(camera, points_a, points_b, start, config)


def compare_units(camera: StereoCamera, points_a: Array, points_b: Array, config: GeometryConfig) -> Unit:
    """Unit of b's landmarks (K, 3) in that of a's, each in its own camera's frame, by their depths.

    Where b is seen from a is found by a's landmarks and b's pixels, to which b's unit does not matter; how far
    away b then sees a's landmarks tells it. Unknown, so the same, where they do not agree on a pose.
    """
    T_a_b = _ransac(camera, points_a, points_b, config)
    if T_a_b is None:
        return SAME_UNIT
    seen = se3.transform(se3.inverse(T_a_b), points_a)
    off = _stereo_pixels(camera, seen)[:, :2] - _stereo_pixels(camera, points_b)[:, :2]
    good = (np.linalg.norm(off, axis=1) < config.ransac_error_px) & (seen[:, 2] > 0)
    if good.sum() < MIN_LANDMARKS:
        return SAME_UNIT
    logs = np.log(seen[good, 2] / points_b[good, 2])
    middle = float(np.median(logs))
    spread = _MAD_TO_SIGMA * float(np.median(np.abs(logs - middle)))
    return Unit(middle, float(np.hypot(spread / np.sqrt(good.sum()), config.systematic_unit)))


def pose_from_pixels(
    camera: PinholeCamera, points: Array, pixels: Array, error_px: float, iterations: int
) -> Array | None:
    """First guess of T_points_camera (4, 4) from points (K, 3) and the pixels (K, 2) that show them, or None.

    OpenCV seeds its generator itself. The guess that RANSAC returns is EPnP's on its inliers, which a few landmarks at
    kilometres, of a disparity near zero, throw off by metres. SQPnP (Terzakis, Lourakis, ECCV 2020) bears them.

    Args:
        camera: intrinsics.
        points: in whatever frame the pose is to be found in.
        pixels: of the camera.
        error_px: reprojection error of an inlier.
        iterations: samples drawn at most.
    """
    if len(points) < MIN_LANDMARKS:
        return None
    points, pixels = np.ascontiguousarray(points), np.ascontiguousarray(pixels)
    try:
        found, _, _, agree = cv2.solvePnPRansac(
            points,
            pixels,
            camera.K,
            None,
            iterationsCount=iterations,
            reprojectionError=error_px,
            confidence=0.9999,
            flags=cv2.SOLVEPNP_AP3P,
        )
        if not found or agree is None:
            return None
        agree = agree[:, 0]
        found, w, t = cv2.solvePnP(points[agree], pixels[agree], camera.K, None, flags=cv2.SOLVEPNP_SQPNP)
    except cv2.error:  # thrown on degenerate configurations
        return None
    if not found or not np.isfinite(w).all() or not np.isfinite(t).all():
        return None
    return se3.inverse(se3.pose(cv2.Rodrigues(w)[0], t[:, 0]))


def _ransac(camera: StereoCamera, points_a: Array, points_b: Array, config: GeometryConfig) -> Array | None:
    """First guess of T_a_b (4, 4) from a's points and b's left pixels."""
    pixels_b = _stereo_pixels(camera, points_b)[:, :2]
    return pose_from_pixels(camera, points_a, pixels_b, config.ransac_error_px, config.ransac_iterations)


def _refined(
    camera: StereoCamera, points_a: Array, points_b: Array, T_a_b: Array, config: GeometryConfig
) -> RelativePose | None:
    """Reweighted least squares, then a plain one on the inliers for an honest covariance."""
    system = _System(camera, points_a, points_b, config)
    for _ in range(_ROUNDS):
        chi2 = system.linearize(T_a_b)
        step = system.step(1.0 / (1.0 + chi2 * _MEDIAN_3 / np.median(chi2)))  # Cauchy's weights
        T_a_b = T_a_b @ se3.exp(step)
        if np.abs(step).max() < _SETTLED:
            break
    chi2 = system.linearize(T_a_b)
    # The better half tells the noise; where most matches are wrong it tells nothing, hence the bound.
    inliers = chi2 < _LIMIT_3 * np.clip(np.median(chi2) / _MEDIAN_3, 1.0, 4.0)
    if inliers.sum() < MIN_LANDMARKS:
        return None
    for _ in range(_POLISH):
        T_a_b = T_a_b @ se3.exp(system.step(inliers))
        chi2 = system.linearize(T_a_b)
    variance = float(chi2[inliers].sum()) / (3 * int(inliers.sum()) - 6)
    bias = config.systematic_disparity_px * system.effect_of_disparity(inliers)
    covariance = max(variance, 1.0) * np.linalg.inv(system.information(inliers))
    covariance = covariance + config.systematic(T_a_b) + np.outer(bias, bias)
    if not (np.isfinite(T_a_b).all() and np.isfinite(covariance).all()):
        return None
    return RelativePose(T_a_b, np.asarray(covariance, dtype=np.float64), inliers, float(np.sqrt(variance)))


class _System:
    """The linearised errors of matched landmarks: (u, v, d) in b as predicted from a, whitened."""

    def __init__(self, camera: StereoCamera, points_a: Array, points_b: Array, config: GeometryConfig) -> None:
        self._camera, self._points_a = camera, points_a
        self._noise = np.diag(np.square([config.sigma_px, config.sigma_px, config.sigma_disparity_px]))
        self._measured = _stereo_pixels(camera, points_b)
        self._to_point = np.linalg.inv(_pixel_jacobian(camera, points_a))
        self._point_noise = self._to_point @ self._noise @ np.swapaxes(self._to_point, 1, 2)

    def linearize(self, T_a_b: Array) -> Array:
        """Errors and Jacobians at a pose; returns chi-square (K,), the noise of both images counted."""
        points_b = se3.transform(se3.inverse(T_a_b), self._points_a)
        J = _pixel_jacobian(self._camera, points_b)
        rotated = J @ T_a_b[:3, :3].T
        covariance = self._noise + rotated @ self._point_noise @ np.swapaxes(rotated, 1, 2)
        whiten = np.linalg.inv(np.linalg.cholesky(covariance))
        error = self._measured - _stereo_pixels(self._camera, points_b)
        self._error = (whiten @ error[:, :, None])[:, :, 0]
        # one more pixel of disparity in both images: what b shows, less what a predicts
        shift = np.array([0.0, 0.0, 1.0]) - np.einsum("kij,kj->ki", rotated, self._to_point[:, :, 2])
        self._shift = (whiten @ shift[:, :, None])[:, :, 0]
        # T exp(xi) moves a point X of frame b by X x w - v
        motion = np.concatenate([hats(points_b), np.tile(-np.eye(3), (len(J), 1, 1))], axis=2)
        self._jacobian = whiten @ J @ motion
        return np.asarray(np.sum(self._error**2, axis=1))

    def information(self, weights: Array | Mask) -> Array:
        """Information (6, 6) of the landmarks under weights (K,)."""
        J = self._jacobian.reshape(-1, 6)
        return np.asarray((J * np.repeat(weights, 3)[:, None]).T @ J)

    def step(self, weights: Array | Mask) -> Array:
        """Gauss-Newton step (6,) under weights (K,), from where `linearize` was called last."""
        return self._answer(self._error, weights)

    def effect_of_disparity(self, weights: Array | Mask) -> Array:
        """Change of the solution (6,) for one pixel more of disparity everywhere."""
        return self._answer(self._shift, weights)

    def _answer(self, errors: Array, weights: Array | Mask) -> Array:
        right = self._jacobian.reshape(-1, 6).T @ (errors * weights[:, None]).ravel()
        return np.asarray(np.linalg.lstsq(self.information(weights), right, rcond=None)[0])


def _stereo_pixels(camera: StereoCamera, points: Array) -> Array:
    """(K, 3): u, v and disparity, pixels, of points (K, 3)."""
    x, y, z = points.T
    z = np.where(np.abs(z) > 1e-3, z, 1e-3)
    u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
    return np.stack([u, v, camera.fx * camera.baseline / z], axis=1)


def _pixel_jacobian(camera: StereoCamera, points: Array) -> Array:
    """(K, 3, 3) derivative of `_stereo_pixels` by the point."""
    x, y, z = points.T
    z = np.where(np.abs(z) > 1e-3, z, 1e-3)
    J = np.zeros((len(points), 3, 3))
    J[:, 0, 0], J[:, 0, 2] = camera.fx / z, -camera.fx * x / z**2
    J[:, 1, 1], J[:, 1, 2] = camera.fy / z, -camera.fy * y / z**2
    J[:, 2, 2] = -camera.fx * camera.baseline / z**2
    return J


def hats(points: Array) -> Array:
    """Skew matrices (K, 3, 3) of points (K, 3)."""
    x, y, z = points.T
    o = np.zeros_like(x)
    return np.stack([o, -z, y, z, o, -x, -y, x, o], axis=1).reshape(-1, 3, 3)
