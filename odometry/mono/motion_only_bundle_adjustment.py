"""Motion-only bundle adjustment: the pose of one image from points whose depths are more or less known.

The problem is that of `odometry.mono.mono_bundle_adjustment` with all poses but one fixed.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.inverse_depth_points import Points, clamp_points
from odometry.kernels.mono_bundle_equations import build_normal_equations
from odometry.mono.mono_bundle_adjustment import MonoBundle, intrinsics
from odometry.mono.mono_frontend import MonoTracks

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_LIMIT = 18.4  # squared residual of an outlier, in variances: see `odometry.mono.mono_bundle_adjustment`
# The noise is measured at a low quantile because most of the view may belong to another car; 0.713 is the 30 % quantile
# of chi squared with two degrees of freedom.
_QUANTILE, _AT_QUANTILE = 0.3, 0.713
_EXACT = 1e6  # weight of a point's place in its anchor, which the map has adjusted already
_DAMPING = 1e-3  # information, 1/rad² and 1/m²


@dataclass(frozen=True)
class PoseEstimationConfig:
    """Iterations and noise levels of the motion-only adjustment.

    Attributes:
        max_iterations: Gauss-Newton steps at most.
        initial_noise_px: noise level assumed in the first step, at least, and halved in each.
        min_noise_px: smallest noise level that is assumed, pixels.
        convergence_threshold: largest step, radians and metres, at which the iteration ends.
    """

    max_iterations: int = 10
    initial_noise_px: float = 2.0
    min_noise_px: float = 0.05
    convergence_threshold: float = 1e-4


@dataclass(frozen=True)
class PoseEstimate:
    """Measured pose of an image.

    Attributes:
        T_first_second: (4, 4) its camera in that of an earlier image.
        covariance: (6, 6) of the right perturbation, rotation first.
        inliers: (N,) bool, the tracks that agree.
        noise_px: standard deviation of a measurement, pixels.
        residual_px: root mean square of the inliers' residuals, pixels.
        chi2: (N,) squared residuals of the tracks, pixels squared.
    """

    T_first_second: Array
    covariance: Array
    inliers: Mask
    noise_px: float
    residual_px: float
    chi2: Array


def estimate_pose(
    bundle: MonoBundle, tracks: MonoTracks, T_map_first: Array, T_guess: Array, config: PoseEstimationConfig
) -> PoseEstimate:
    """Estimate the pose of an image from a guess (4, 4) of T_first_second.

    Depths take part with their information: a point of uncertain depth constrains the pose only across its epipolar
    line.
    """
    problem = _PoseProblem(bundle, tracks)
    T, sigma = T_map_first @ T_guess, config.initial_noise_px
    for k in range(config.max_iterations):
        level = max(config.initial_noise_px * 0.5**k, min(sigma, config.initial_noise_px))
        step = problem.step(T, level)
        T, sigma = T @ se3.exp(step), max(problem.noise(), config.min_noise_px)
        if level < 2 * sigma and np.abs(step).max() < config.convergence_threshold:
            break
    problem.step(T, sigma)
    inliers = problem.chi2 < _LIMIT * sigma**2
    residual = float(np.sqrt(problem.chi2[inliers].mean() / 2)) if inliers.any() else float("nan")
    return PoseEstimate(se3.inverse(T_map_first) @ T, problem.covariance(), inliers, sigma, residual, problem.chi2)


class _PoseProblem:
    """Points with two observations: by their anchors, which are fixed, and by the image whose pose is estimated."""

    def __init__(self, bundle: MonoBundle, tracks: MonoTracks) -> None:
        self._points: Points = bundle.points.select(tracks.ids)
        self._poses, self._lens = bundle.poses, bundle.lens
        n, self._new = len(tracks), len(bundle.poses)
        frame = np.stack([self._points.frame, np.full(n, self._new)], axis=1).ravel()
        places = np.stack([self._points.anchor_pixel, tracks.pixels], axis=1).reshape(-1, 2)
        self._observations = (2 * np.arange(n + 1), frame, places)
        self._states = np.full(self._new + 1, -1)
        self._states[self._new] = 0
        self._state = np.column_stack([np.zeros((n, 2)), self._points.inverse_depth])
        self._known = self._points.information > 0
        self.chi2 = np.zeros(n)

    def step(self, T_map_frame: Array, sigma: float) -> Array:
        """Step (6,) of the pose (4, 4) with the noise level sigma, pixels."""
        poses = np.concatenate([self._poses, T_map_frame[None]])
        H, b, chi2, rows, offset, _ = build_normal_equations(
            intrinsics(self._lens), self._observations,
            (self._state, self._points.inverse_depth, self._points.information),
            poses, self._states, self._lens.coefficients, (_LIMIT * sigma**2, 0.0, _EXACT),
        )  # fmt: skip
        self._H, self.chi2 = H[:6, :6] / sigma**2 + _DAMPING * np.eye(6), chi2[1::2]
        step = np.linalg.solve(self._H, -b[:6] / sigma**2)
        self._state = clamp_points(self._state - offset - rows[:, :, :6] @ step)
        return np.asarray(step)

    def noise(self) -> float:
        """Standard deviation of a measurement, pixels, by the smaller residuals of points with known depth."""
        known = self.chi2[self._known]
        return float(np.sqrt(np.quantile(known, _QUANTILE) / _AT_QUANTILE)) if len(known) else 0.0

    def covariance(self) -> Array:
        """Covariance (6, 6) of the pose where it was last linearised."""
        covariance = np.linalg.inv(self._H)
        return np.asarray(0.5 * (covariance + covariance.T))
