"""Relative pose of two stereo images from matched landmarks, with its covariance.

Errors are in stereo pixels: (u, v) of the left image and the disparity d, each with its own noise, in both images.
Residuals and Jacobians: docs/math.md.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from odometry import se3
from odometry.camera import PinholeCamera, StereoCamera

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_CHI2_MEDIAN = 2.366  # of 3 degrees of freedom
_CHI2_LIMIT = 16.27  # 99.9 % of 3 degrees of freedom
_MAD_TO_SIGMA = 1.4826  # of a Gaussian
MIN_LANDMARKS = 6  # with fewer, nothing is left to check a pose
_MAX_ITERATIONS = 15  # of reweighting
_MIN_STEP = 1e-5  # rad and m: a smaller step ends the reweighting
_FINAL_STEPS = 2  # of plain least squares on the inliers
# Where most matches are wrong, their median chi-square does not show the noise: at most this factor is believed.
_MAX_NOISE_FACTOR = 4.0
# No pair sees points of a larger disparity, in image widths, or so far aside, in multiples of their depth.
_MAX_WIDTHS, _MAX_SLOPE = 2.0, 20.0
_MIN_DEPTH = 1e-3  # metres: points in the image plane have no pixel
_RANSAC_CONFIDENCE = 0.9999


@dataclass(frozen=True)
class RelativePoseConfig:
    """Noise of matched landmarks, and settings of RANSAC."""

    ransac_error_px: float = 3.0  # largest reprojection error of an inlier of the first guess
    ransac_iterations: int = 1000  # enough for 25 % inliers and 4 points at 0.98
    sigma_px: float = 0.5  # noise of a landmark's pixel: relative weight, and lower bound of the measured noise
    sigma_disparity_px: float = 0.5  # the same of its disparity
    # Errors that more landmarks do not average out (calibration, rectification), one standard deviation.
    systematic_rad: float = 5e-4  # of rotation, radians
    systematic_rad_per_m: float = 4e-4  # and for each metre between the cameras
    systematic_m: float = 0.005  # of translation, metres
    systematic_m_per_m: float = 0.01  # and for each metre between the cameras
    systematic_log_scale: float = 0.01  # of the log scale of one camera
    systematic_disparity_px: float = 0.2  # of all disparities alike; its effect depends on the depths of the landmarks

    def systematic(self, T_a_b: Array) -> Array:
        """Covariance (6, 6), rotation first, of these errors in a pose (4, 4)."""
        distance = float(np.linalg.norm(T_a_b[:3, 3]))
        rotation = self.systematic_rad + self.systematic_rad_per_m * distance
        translation = self.systematic_m + self.systematic_m_per_m * distance
        return np.diag(np.repeat([rotation**2, translation**2], 3))


@dataclass(frozen=True)
class ScaleRatio:
    """Ratio of two units of length.

    Attributes:
        log: natural logarithm of the ratio.
        sigma: standard deviation of `log`; 0 if the ratio is exact or was not measured.
    """

    log: float
    sigma: float

    @property
    def ratio(self) -> float:
        """The ratio itself."""
        return float(np.exp(self.log))


UNIT_SCALE = ScaleRatio(0.0, 0.0)


@dataclass(frozen=True)
class RelativePose:
    """Relative pose of two cameras that landmarks agree on.

    Attributes:
        T_a_b: (4, 4) camera b in the frame of camera a, metres.
        covariance: (6, 6) of its right perturbation, rotation first: measured noise and systematic errors.
        inliers: (K,) bool over the matched landmarks.
        noise: noise of the inliers as a multiple of the expected one.
    """

    T_a_b: Array
    covariance: Array
    inliers: Mask
    noise: float


def relative_pose(
    camera: StereoCamera, points_a: Array, points_b: Array, config: RelativePoseConfig
) -> RelativePose | None:
    """Pose of camera b in frame a from matched landmarks (K, 3), each in its own camera's frame, metres.

    PnP RANSAC of a's landmarks in b's image, refined on the stereo pixels of both; None if too few landmarks agree.
    """
    start = _initial_pose(camera, points_a, points_b, config)
    try:
        return None if start is None else _refine(camera, points_a, points_b, start, config)
    except np.linalg.LinAlgError:  # a false start at which the landmarks determine no pose
        return None


def estimate_relative_scale(
    camera: StereoCamera, points_a: Array, points_b: Array, config: RelativePoseConfig
) -> ScaleRatio:
    """Scale of b's landmarks (K, 3) in that of a's, each in its own camera's frame, by their depths.

    The pose of b in a follows from a's landmarks and b's pixels, which do not depend on b's scale. The depths of a's
    landmarks in b, over those that b itself has, then give the scale. `UNIT_SCALE` if they do not agree on a pose.
    """
    logs = _log_depth_ratios(camera, points_a, points_b, config)
    if len(logs) < MIN_LANDMARKS:
        return UNIT_SCALE
    middle, spread = _middle_and_spread(logs)
    return ScaleRatio(middle, float(np.hypot(spread / np.sqrt(len(logs)), config.systematic_log_scale)))


def measure_depth_noise(
    camera: StereoCamera, points_a: Array, points_b: Array, config: RelativePoseConfig
) -> RelativePoseConfig:
    """Settings with the noise that the depths of matched landmarks (K, 3) have, at least that of a stereo pair.

    Depths from motion are as good as the parallax that the camera happened to have. How far the depths of two images
    differ shows it, and stands in the settings as the noise of a disparity.
    """
    logs = _log_depth_ratios(camera, points_a, points_b, config)
    if len(logs) < MIN_LANDMARKS:
        return config
    disparity_px = float(np.median(_stereo_pixels(camera, points_a)[:, 2]))
    noise_px = disparity_px * _middle_and_spread(logs)[1] / np.sqrt(2.0)  # half of the variance comes from each image
    return replace(config, sigma_disparity_px=max(config.sigma_disparity_px, noise_px))


def _middle_and_spread(values: Array) -> tuple[float, float]:
    """Median of values (N,) and their standard deviation by the median deviation."""
    middle = float(np.median(values))
    return middle, _MAD_TO_SIGMA * float(np.median(np.abs(values - middle)))


def _log_depth_ratios(camera: StereoCamera, points_a: Array, points_b: Array, config: RelativePoseConfig) -> Array:
    """Log (M,) of the depths of a's landmarks in b over b's own, of those that agree on a pose by their pixels."""
    T_a_b = _initial_pose(camera, points_a, points_b, config)
    if T_a_b is None:
        return np.zeros(0)
    seen = se3.transform(se3.inverse(T_a_b), points_a)
    off = _stereo_pixels(camera, seen)[:, :2] - _stereo_pixels(camera, points_b)[:, :2]
    good = (np.linalg.norm(off, axis=1) < config.ransac_error_px) & (seen[:, 2] > 0)
    return np.asarray(np.log(seen[good, 2] / points_b[good, 2]))


def pnp_ransac(camera: PinholeCamera, points: Array, pixels: Array, error_px: float, iterations: int) -> Array | None:
    """T_points_camera (4, 4) from points (K, 3) and their pixels (K, 2) by PnP and RANSAC; None if that fails.

    OpenCV seeds its generator itself. RANSAC ends with EPnP on its inliers, which is biased by metres by a few very
    distant landmarks, whose disparity is near zero; SQPnP (Terzakis and Lourakis, ECCV 2020) is not.

    Args:
        camera: intrinsics.
        points: (K, 3) in the frame in which the pose is wanted.
        pixels: (K, 2) of the points in the image.
        error_px: largest reprojection error of an inlier.
        iterations: largest number of samples.
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
            confidence=_RANSAC_CONFIDENCE,
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


def _initial_pose(camera: StereoCamera, points_a: Array, points_b: Array, config: RelativePoseConfig) -> Array | None:
    """First guess of T_a_b (4, 4) from a's points and b's left pixels, or None."""
    pixels_b = _stereo_pixels(camera, points_b)[:, :2]
    return pnp_ransac(camera, points_a, pixels_b, config.ransac_error_px, config.ransac_iterations)


def _refine(
    camera: StereoCamera, points_a: Array, points_b: Array, T_a_b: Array, config: RelativePoseConfig
) -> RelativePose | None:
    """Pose by reweighted least squares, then by plain least squares on the inliers, whose covariance is known."""
    system = _StereoAlignment(camera, points_a, points_b, config)
    for _ in range(_MAX_ITERATIONS):
        chi2 = system.linearize(T_a_b)
        if not np.isfinite(np.median(chi2)):
            return None  # most landmarks are not before the camera
        step = system.step(1.0 / (1.0 + chi2 * _CHI2_MEDIAN / np.median(chi2)))  # Cauchy's weights
        T_a_b = T_a_b @ se3.exp(step)
        if np.abs(step).max() < _MIN_STEP:
            break
    chi2 = system.linearize(T_a_b)
    # The better half of the matches gives the noise.
    inliers = chi2 < _CHI2_LIMIT * np.clip(np.median(chi2) / _CHI2_MEDIAN, 1.0, _MAX_NOISE_FACTOR)
    if inliers.sum() < MIN_LANDMARKS:
        return None
    for _ in range(_FINAL_STEPS):
        T_a_b = T_a_b @ se3.exp(system.step(inliers))
        chi2 = system.linearize(T_a_b)
    if not np.isfinite(chi2[inliers]).all():
        return None  # the last steps have diverged
    variance = float(chi2[inliers].sum()) / (3 * int(inliers.sum()) - 6)
    bias = config.systematic_disparity_px * system.effect_of_disparity(inliers)
    covariance = max(variance, 1.0) * np.linalg.inv(system.information(inliers))
    covariance = covariance + config.systematic(T_a_b) + np.outer(bias, bias)
    if not (np.isfinite(T_a_b).all() and np.isfinite(covariance).all()):
        return None
    return RelativePose(T_a_b, np.asarray(covariance, dtype=np.float64), inliers, float(np.sqrt(variance)))


class _StereoAlignment:
    """Linearised, whitened errors (u, v, d) of matched landmarks in b, as predicted from a."""

    def __init__(self, camera: StereoCamera, points_a: Array, points_b: Array, config: RelativePoseConfig) -> None:
        self._intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.baseline, camera.width])
        self._points_a = np.ascontiguousarray(points_a)
        self._noise = np.diag(np.square([config.sigma_px, config.sigma_px, config.sigma_disparity_px]))
        self._measured = _stereo_pixels(camera, points_b)
        self._to_point = np.linalg.inv(_pixel_jacobian(camera, points_a))
        self._point_noise = self._to_point @ self._noise @ np.swapaxes(self._to_point, 1, 2)

    def linearize(self, T_a_b: Array) -> Array:
        """Set errors and Jacobians at a pose; chi-square (K,) by the noise of both images, infinite where unseen."""
        landmarks = self._points_a, self._point_noise, self._measured
        found = _linearize(self._intrinsics, landmarks, self._noise, np.ascontiguousarray(T_a_b))
        self._error, self._jacobian, self._whiten, self._rotated, chi2 = found
        return chi2

    def information(self, weights: Array | Mask) -> Array:
        """Information (6, 6) of the pose by the landmarks under weights (K,)."""
        J = self._jacobian.reshape(-1, 6)
        return np.asarray((J * np.repeat(weights, 3)[:, None]).T @ J)

    def step(self, weights: Array | Mask) -> Array:
        """Gauss-Newton step (6,) under weights (K,), from where `linearize` was called last."""
        return self._solve(self._error, weights)

    def effect_of_disparity(self, weights: Array | Mask) -> Array:
        """Change of the solution (6,) for one pixel more of disparity everywhere."""
        return self._solve(self._disparity_errors(), weights)

    def _disparity_errors(self) -> Array:
        """Whitened errors (K, 3) of one more pixel of disparity in both images."""
        # Change of the measurement, less change of the prediction
        shift = np.array([0.0, 0.0, 1.0]) - np.einsum("kij,kj->ki", self._rotated, self._to_point[:, :, 2])
        return np.asarray((self._whiten @ shift[:, :, None])[:, :, 0])

    def _solve(self, errors: Array, weights: Array | Mask) -> Array:
        right = self._jacobian.reshape(-1, 6).T @ (errors * weights[:, None]).ravel()
        return np.asarray(np.linalg.lstsq(self.information(weights), right, rcond=None)[0])


def _stereo_pixels(camera: StereoCamera, points: Array) -> Array:
    """(K, 3): u, v and disparity, pixels, of points (K, 3)."""
    x, y, z = points.T
    z = np.where(np.abs(z) > _MIN_DEPTH, z, _MIN_DEPTH)
    u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
    return np.stack([u, v, camera.fx * camera.baseline / z], axis=1)


def _pixel_jacobian(camera: StereoCamera, points: Array) -> Array:
    """(K, 3, 3) derivative of `_stereo_pixels` by the point."""
    x, y, z = points.T
    z = np.where(np.abs(z) > _MIN_DEPTH, z, _MIN_DEPTH)
    J = np.zeros((len(points), 3, 3))
    J[:, 0, 0], J[:, 0, 2] = camera.fx / z, -camera.fx * x / z**2
    J[:, 1, 1], J[:, 1, 2] = camera.fy / z, -camera.fy * y / z**2
    J[:, 2, 2] = -camera.fx * camera.baseline / z**2
    return J


@njit(cache=True, nogil=True, error_model="numpy")
def _linearize(
    camera: Array, landmarks: tuple[Array, Array, Array], noise: Array, T_a_b: Array
) -> tuple[Array, Array, Array, Array, Array]:
    """Whitened errors of landmarks in image b, and their derivatives by the pose.

    Args:
        camera: (6,) fx, fy, cx, cy in pixels, baseline in metres, width in pixels.
        landmarks: points (K, 3) in frame a, their covariances (K, 3, 3), and stereo pixels (K, 3) measured in b.
        noise: (3, 3) covariance of stereo pixels.
        T_a_b: (4, 4) camera b in frame a, metres.

    Returns:
        Errors (K, 3), Jacobians (K, 3, 6), whitening matrices (K, 3, 3), derivatives (K, 3, 3) of the stereo pixels by
        the points in frame a, and chi-square (K,). Of a point that b cannot see these are zero, and infinity.
    """
    points, point_noise, measured = landmarks
    fx, fy, cx, cy, baseline, width = camera
    n = len(points)
    error, jacobian, chi2 = np.zeros((n, 3)), np.zeros((n, 3, 6)), np.full(n, np.inf)
    whiten, rotated = np.zeros((n, 3, 3)), np.zeros((n, 3, 3))
    J, W, covariance, product = np.zeros((3, 3)), np.zeros((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    motion = np.zeros((3, 6))
    for k in range(n):
        x, y, z = _in_camera(T_a_b, points[k])
        # A false pose puts some points so near that their noise has no bound: no pair sees these.
        if not (fx * baseline < _MAX_WIDTHS * width * z and max(abs(x), abs(y)) < _MAX_SLOPE * z):
            continue
        J[0, 0], J[0, 2] = fx / z, -fx * x / z**2
        J[1, 1], J[1, 2] = fy / z, -fy * y / z**2
        J[2, 2] = -fx * baseline / z**2
        _multiply(J, T_a_b[:3, :3].T, rotated[k])
        _multiply(rotated[k], point_noise[k], product)
        _multiply(product, rotated[k].T, covariance)
        covariance += noise
        _invert_cholesky(covariance, W)
        if not np.isfinite(W[2, 2]):
            continue
        whiten[k] = W
        # T exp(xi) moves a point X of frame b by X x w - v, for xi = (w, v)
        motion[0, 1], motion[0, 2], motion[0, 3] = -z, y, -1.0
        motion[1, 0], motion[1, 2], motion[1, 4] = z, -x, -1.0
        motion[2, 0], motion[2, 1], motion[2, 5] = -y, x, -1.0
        _multiply(W, J, product)
        _multiply(product, motion, jacobian[k])
        u, v = measured[k, 0] - fx * x / z - cx, measured[k, 1] - fy * y / z - cy
        d = measured[k, 2] - fx * baseline / z
        chi2[k] = 0.0
        for i in range(3):
            error[k, i] = W[i, 0] * u + W[i, 1] * v + W[i, 2] * d
            chi2[k] += error[k, i] ** 2
    return error, jacobian, whiten, rotated, chi2


@njit(cache=True, forceinline=True)
def _in_camera(T_a_b: Array, point: Array) -> tuple[float, float, float]:
    """Coordinates in frame b of a point (3,) in frame a."""
    dx, dy, dz = point[0] - T_a_b[0, 3], point[1] - T_a_b[1, 3], point[2] - T_a_b[2, 3]
    return (
        T_a_b[0, 0] * dx + T_a_b[1, 0] * dy + T_a_b[2, 0] * dz,
        T_a_b[0, 1] * dx + T_a_b[1, 1] * dy + T_a_b[2, 1] * dz,
        T_a_b[0, 2] * dx + T_a_b[1, 2] * dy + T_a_b[2, 2] * dz,
    )


@njit(cache=True, forceinline=True)
def _multiply(A: Array, B: Array, out: Array) -> None:
    """Set `out` (3, N) to the product of A (3, 3) and B (3, N): a library takes ten times as long for so few."""
    for i in range(3):
        for j in range(B.shape[1]):
            out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]


@njit(cache=True, forceinline=True, error_model="numpy")
def _invert_cholesky(A: Array, out: Array) -> None:
    """Set `out` to the inverse of the lower Cholesky factor of a covariance (3, 3); not finite where it is none."""
    a = np.sqrt(A[0, 0])
    b, c = A[1, 0] / a, A[2, 0] / a
    d = np.sqrt(A[1, 1] - b * b)
    e = (A[2, 1] - b * c) / d
    f = np.sqrt(A[2, 2] - c * c - e * e)
    out[0, 0], out[1, 1], out[2, 2] = 1 / a, 1 / d, 1 / f
    out[1, 0], out[2, 1] = -b / (a * d), -e / (d * f)
    out[2, 0] = (b * e - c * d) / (a * d * f)
