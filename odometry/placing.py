"""Where one image was taken, seen from points whose depths are more or less known."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.bundle import Bundle, intrinsics
from odometry.kernels.mono_bundle_adjustment import build_normal_equations
from odometry.mono_tracks import Tracks
from odometry.points import Points, settled

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_LIMIT = 18.4  # squared residual of an outlier, in variances: see `odometry.bundle`
_QUANTILE, _AT_QUANTILE = 0.3, 0.713  # of chi squared, two degrees of freedom: most of the view may be another car
_EXACT = 1e6  # weight of where the map says that a point was first seen
_DAMPING = 1e-3  # information, 1/rad² and 1/m²


@dataclass(frozen=True)
class PlacingConfig:
    """How the pose of an image is computed.

    Attributes:
        iterations: most steps.
        start_px: noise level assumed in the first step, at least, and halved in each.
        floor_px: smallest noise level that is believed, pixels.
        converged: largest step, radians and metres, that counts as none.

    """

    iterations: int = 10
    start_px: float = 2.0
    floor_px: float = 0.05
    converged: float = 1e-4


@dataclass(frozen=True)
class Placed:
    """Where an image was taken.

    Attributes:
        T_first_second: (4, 4) its camera in that of an earlier image.
        covariance: (6, 6) of the right perturbation, rotation first.
        inliers: (N,) bool, the tracks that agree.
        noise_px: standard deviation of a measurement, pixels.
        residual_px: root mean square of the inliers' residuals, pixels.

    """

    T_first_second: Array
    covariance: Array
    inliers: Mask
    noise_px: float
    residual_px: float


def place(bundle: Bundle, tracks: Tracks, T_map_first: Array, T_guess: Array, config: PlacingConfig) -> Placed:
    """Find the camera of an image near a guess (4, 4) of T_first_second.

    Depths take part with what is known of them, so an unsure one pulls only across its ray's image.
    """
    problem = _Problem(bundle, tracks)
    T, sigma = T_map_first @ T_guess, config.start_px
    for k in range(config.iterations):
        level = max(config.start_px * 0.5**k, min(sigma, config.start_px))
        step = problem.step(T, level)
        T, sigma = T @ se3.exp(step), max(problem.noise(), config.floor_px)
        if level < 2 * sigma and np.abs(step).max() < config.converged:
            break
    problem.step(T, sigma)
    inliers = problem.chi2 < _LIMIT * sigma**2
    residual = float(np.sqrt(problem.chi2[inliers].mean() / 2)) if inliers.any() else float("nan")
    return Placed(se3.inverse(T_map_first) @ T, problem.covariance(), inliers, sigma, residual)


class _Problem:
    """Points seen by the frames that saw them first, which are fixed, and by the one that is looked for."""

    def __init__(self, bundle: Bundle, tracks: Tracks) -> None:
        self._points: Points = bundle.points.at(tracks.ids)
        self._poses, self._lens = bundle.poses, bundle.lens
        n, self._new = len(tracks), len(bundle.poses)
        frame = np.stack([self._points.frame, np.full(n, self._new)], axis=1).ravel()
        places = np.stack([self._points.place, tracks.pixels], axis=1).reshape(-1, 2)
        self._sightings = (2 * np.arange(n + 1), frame, places)
        self._states = np.full(self._new + 1, -1)
        self._states[self._new] = 0
        self._state = np.column_stack([np.zeros((n, 2)), self._points.depth])
        self._known = self._points.trust > 0
        self.chi2 = np.zeros(n)

    def step(self, T_map_frame: Array, sigma: float) -> Array:
        """Step (6,) of the pose (4, 4) with the noise level sigma, pixels."""
        poses = np.concatenate([self._poses, T_map_frame[None]])
        H, b, chi2, rows, offset, _ = build_normal_equations(
            intrinsics(self._lens), self._sightings, (self._state, self._points.depth, self._points.trust),
            poses, self._states, self._lens.coefficients, (_LIMIT * sigma**2, 0.0, _EXACT),
        )  # fmt: skip
        self._H, self.chi2 = H[:6, :6] / sigma**2 + _DAMPING * np.eye(6), chi2[1::2]
        step = np.linalg.solve(self._H, -b[:6] / sigma**2)
        self._state = settled(self._state - offset - rows[:, :, :6] @ step)
        return np.asarray(step)

    def noise(self) -> float:
        """Standard deviation of a measurement, pixels, by the smaller residuals of points with known depth."""
        known = self.chi2[self._known]
        return float(np.sqrt(np.quantile(known, _QUANTILE) / _AT_QUANTILE)) if len(known) else 0.0

    def covariance(self) -> Array:
        """Covariance (6, 6) of the pose where it was last linearised."""
        covariance = np.linalg.inv(self._H)
        return np.asarray(0.5 * (covariance + covariance.T))
