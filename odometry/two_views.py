"""Motion between two stereo pairs: depths, motion and rectification error in one robust adjustment.

A point is the pixel of its track in the first left image, which the tracker compares everything with and is
therefore exact, and an inverse depth. Its places in the other three images are six measurements. Estimating
the inverse depth with the motion, instead of fixing it by triangulation, takes away the bias that noisy
depths of far points bring (Civera et al., Inverse Depth Parametrization, TRO 2008); it is eliminated point
by point, by the Schur complement (Triggs et al., Bundle Adjustment, 1999, section 6). No point is too far:
one at infinity still measures rotation. Weights are those of Geman and McClure at a noise level measured
from the residuals themselves.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.normal_equations import accumulate
from odometry.rectification import Rectification

Array = NDArray[np.float64]

# Quantiles of chi squared with five degrees of freedom: six measurements less one depth.
_MEDIAN, _LIMIT = 4.351, 15.09
_NEAREST = 0.3  # m; nothing is seen closer
_DAMPING = 1e-3  # information, 1/rad² and 1/m², about motions that no point constrains: keeps matrices regular


@dataclass(frozen=True)
class StereoTracks:
    """Points seen in two stereo pairs.

    Attributes:
        first_left, first_right, second_left, second_right: (N, 2) pixels.

    """

    first_left: Array
    first_right: Array
    second_left: Array
    second_right: Array

    def __len__(self) -> int:
        return len(self.first_left)

    def measurements(self) -> Array:
        """(N, 6) pixels, columns and rows: first right, second left, and second right less second left.

        The tracker finds each of them by itself: the second right place starts from the second left one and
        inherits its error, their difference does not.
        """
        return np.concatenate([self.first_right, self.second_left, self.second_right - self.second_left], axis=1)


@dataclass(frozen=True)
class AdjustmentConfig:
    """How the adjustment goes about it.

    Attributes:
        iterations: most steps.
        start_px: noise level assumed in the first step, at least, and halved in each.
        floor_px: smallest noise level that is believed, pixels.
        converged: largest step, radians and metres, that counts as none.

    """

    iterations: int = 12
    start_px: float = 4.0
    floor_px: float = 0.05
    converged: float = 1e-5


@dataclass(frozen=True)
class TwoViewEstimate:
    """The result of the adjustment.

    Attributes:
        T_first_second: (4, 4) second camera in the first camera's frame, metres.
        covariance: (6, 6) of the right perturbation, rotation first; counts in the rectification.
        inliers: (N,) bool, the points whose six residuals agree with the motion.
        noise_px: standard deviation of one measurement, pixels.
        residual_px: root mean square of the inliers' residuals, pixels.
        rectification: (12,) coefficients, estimated with the motion.
        information: (12, 12) what this pair of views said about them.

    """

    T_first_second: Array
    covariance: Array
    inliers: NDArray[np.bool_]
    noise_px: float
    residual_px: float
    rectification: Array
    information: Array


def estimate_motion(
    tracks: StereoTracks, rectification: Rectification, T_guess: Array, config: AdjustmentConfig | None = None
) -> TwoViewEstimate:
    """Adjust motion, depths and rectification to the tracks, from a guess (4, 4) of T_first_second."""
    config = config or AdjustmentConfig()
    problem = _Problem(tracks, rectification, se3.inverse(T_guess))
    sigma = config.start_px
    for k in range(config.iterations):
        start = config.start_px * 0.5**k
        step = problem.step(max(start, min(sigma, config.start_px)))
        sigma = max(problem.noise(), config.floor_px)
        if start < sigma and np.abs(step).max() < config.converged:
            break
    return problem.result(sigma)


def ransac_motion(tracks: StereoTracks, rectification: Rectification) -> Array | None:
    """T_first_second (4, 4) that most tracks agree with, by minimal samples (P3P), or None."""
    camera = rectification.camera
    disparity = tracks.first_left[:, 0] - tracks.first_right[:, 0]
    points = camera.triangulate(tracks.first_left, np.maximum(rectification.correct(tracks.first_left, disparity), 0.5))
    try:
        found, w, t, _ = cv2.solvePnPRansac(
            points,
            tracks.second_left,
            camera.K,
            None,
            iterationsCount=200,
            reprojectionError=2.0,
            flags=cv2.SOLVEPNP_AP3P,
        )
    except cv2.error:
        return None
    T_second_first = se3.pose(cv2.Rodrigues(w)[0], t.ravel()) if found else None
    return None if T_second_first is None or not np.isfinite(T_second_first).all() else se3.inverse(T_second_first)


class _Problem:
    """The state of one adjustment and its Gauss-Newton steps."""

    def __init__(self, tracks: StereoTracks, prior: Rectification, T_second_first: Array) -> None:
        camera = prior.camera
        self._camera = np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.baseline])
        self._rays = (tracks.first_left - self._camera[2:4]) / self._camera[:2]
        self._measured = np.ascontiguousarray(tracks.measurements())
        self._prior, self._prior_information = prior, np.linalg.inv(prior.covariance)
        disparity = prior.correct(tracks.first_left, tracks.first_left[:, 0] - tracks.first_right[:, 0])
        self._inverse_depth = self._bounded(disparity / (camera.fx * camera.baseline))
        self._T_second_first, self._rectification = T_second_first, prior.coefficients.copy()
        self._linearise(np.inf)

    def step(self, sigma: float) -> Array:
        """One step with the noise level sigma, pixels; returns the change of the pose (6,)."""
        H, b = self._linearise(sigma)
        H, b = H / sigma**2, b / sigma**2
        H[6:, 6:] += self._prior_information
        b[6:] += self._prior_information @ (self._rectification - self._prior.coefficients)
        change = np.linalg.solve(H + _DAMPING * np.eye(len(H)), -b).astype(np.float64)
        self._inverse_depth = self._bounded(self._inverse_depth - self._depth_offset - self._depth_rows @ change)
        self._T_second_first = se3.exp(change[:6]) @ self._T_second_first
        self._rectification = self._rectification + change[6:]
        return change[:6]

    def noise(self) -> float:
        """Measure the standard deviation of a measurement, pixels, by the median of the squared residuals."""
        return float(np.sqrt(np.median(self._chi2) / _MEDIAN))

    def result(self, sigma: float) -> TwoViewEstimate:
        """Sum up what has been found, with its uncertainty at the noise level sigma, pixels."""
        self._linearise(sigma)
        inliers = self._chi2 < _LIMIT * sigma**2
        # What is certain about an estimate is what all its inliers say: the weights only chose them.
        H = self._information(inliers) / sigma**2 + _DAMPING * np.eye(len(self._prior_information) + 6)
        inverse = np.linalg.inv(H[:6, :6])
        gain = inverse @ H[:6, 6:]
        information = H[6:, 6:] - H[6:, :6] @ gain
        known = np.linalg.inv(self._prior_information + information)
        T_first_second = se3.inverse(self._T_second_first)
        # The step perturbs T_second_first on the left: exp(xi) T is the inverse of T^-1 exp(-xi).
        covariance = inverse + gain @ known @ gain.T
        return TwoViewEstimate(
            T_first_second=T_first_second,
            covariance=0.5 * (covariance + covariance.T),
            inliers=inliers,
            noise_px=sigma,
            residual_px=float(np.sqrt(self._chi2[inliers].mean() / 6.0)) if inliers.any() else float("nan"),
            rectification=self._rectification,
            information=0.5 * (information + information.T),
        )

    def _linearise(self, sigma: float) -> tuple[Array, Array]:
        """Sum up the normal equations (18, 18), (18,); keeps what the depths need."""
        H, b, self._chi2, self._depth_rows, self._depth_offset = accumulate(
            self._camera, self._rays, self._measured, self._inverse_depth,
            self._T_second_first, self._rectification, _LIMIT * sigma**2,
        )  # fmt: skip
        return H, b

    def _information(self, points: NDArray[np.bool_]) -> Array:
        """Hessian (18, 18) of some of the points, all with weight one, pixels squared."""
        H, *_ = accumulate(
            self._camera, self._rays[points], self._measured[points], self._inverse_depth[points],
            self._T_second_first, self._rectification, np.inf,
        )  # fmt: skip
        return H

    def _bounded(self, inverse_depth: Array) -> Array:
        """Inverse depths that a camera can see: in front of it, and not closer than a bumper."""
        return np.clip(inverse_depth, 1e-6, 1.0 / _NEAREST)
