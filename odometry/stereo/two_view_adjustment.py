"""Motion between two stereo pairs: depths, motion and calibration error in one robust adjustment.

A point is its pixel in the first left image, exact because the tracker compares everything with it, and an inverse
depth. Its places in the other three images are six measurements. Estimating the inverse depth with the motion,
instead of fixing it by triangulation, takes away the bias that noisy depths of far points bring (Civera et al.,
Inverse Depth Parametrization, TRO 2008). A point at infinity still measures rotation. Weights are those of Geman and
McClure at a noise level measured from the residuals. Derivation: docs/math.md, section "Two stereo views".
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.camera import clamp_inverse_depth
from odometry.kernels.two_view_equations import build_normal_equations
from odometry.stereo.second_view import RIGHT_IMAGE_NOISE, SecondViewNoise
from odometry.stereo.stereo_self_calibration import NUM_COEFFICIENTS, Calibration

Array = NDArray[np.float64]

# Chi squared with five degrees of freedom (six measurements less one depth). The noise is measured at a low quantile,
# because most of the view may belong to another car. Errors of tracks have heavier tails than a Gaussian: with 2.4
# instead of its 3.0 the result equals that of the median where nothing else moves. A depth image measures no row, and
# not every depth: of one to three degrees of freedom the quantile is as much smaller than that of a Gaussian.
_QUANTILE = 0.3
_AT_QUANTILE = np.array([np.nan, 0.119, 0.571, 1.139, np.nan, 2.4])
_LIMIT = np.array([np.nan, 6.63, 9.21, 11.34, np.nan, 15.09])  # 99 %
_DAMPING = 1e-3  # information, 1/rad² and 1/m², about motions that no point constrains: keeps matrices regular


@dataclass(frozen=True)
class StereoTracks:
    """Points seen in two stereo pairs.

    Attributes:
        first_left, first_right, second_left, second_right: (N, 2) pixels; NaN on the right where a depth is unknown.
        ids: (N,) growing numbers of the tracks, -1 where there is no track.
        noise: of the places on the right.
    """

    first_left: Array
    first_right: Array
    second_left: Array
    second_right: Array
    ids: NDArray[np.int64]
    noise: SecondViewNoise = RIGHT_IMAGE_NOISE

    def __len__(self) -> int:
        return len(self.first_left)

    @property
    def has_depth(self) -> NDArray[np.bool_]:
        """Mask (N,) of the points whose place in the first right image is known."""
        return np.isfinite(self.first_right[:, 0])

    def select(self, chosen: NDArray[np.bool_]) -> "StereoTracks":
        """Return some of the points, chosen by (N,) bool."""
        return StereoTracks(
            self.first_left[chosen],
            self.first_right[chosen],
            self.second_left[chosen],
            self.second_right[chosen],
            self.ids[chosen],
            self.noise,
        )

    def stack_pixels(self) -> tuple[Array, Array]:
        """Return all places, (N, 4, 2) pixels, in the order of the attributes, and factors (N, 2) of those right.

        A depth that is unknown in the first image is that of the other points, with little weight.
        """
        first, first_factor = self.noise.weights(self.first_left, self.first_right, fill=True)
        second, second_factor = self.noise.weights(self.second_left, self.second_right)
        pixels = np.stack([self.first_left, first, self.second_left, second], axis=1)
        return pixels, np.stack([first_factor, second_factor], axis=1)

    def count_freedom(self) -> NDArray[np.int64]:
        """Degrees of freedom (N,) of the points' residuals: measurements less one, the inverse depth."""
        known = self.has_depth.astype(np.int64) + np.isfinite(self.second_right[:, 0])
        return 1 + self.noise.rows * known


@dataclass(frozen=True)
class AdjustmentConfig:
    """Iterations and noise levels of the two-view adjustment.

    Attributes:
        max_iterations: Gauss-Newton steps at most.
        initial_noise_px: noise level assumed in the first step, at least, and halved in each.
        min_noise_px: smallest noise level that is assumed, pixels.
        convergence_threshold: largest step, radians and metres, at which the iteration ends.
    """

    max_iterations: int = 12
    initial_noise_px: float = 2.0
    min_noise_px: float = 0.05
    convergence_threshold: float = 1e-4


@dataclass(frozen=True)
class TwoViewEstimate:
    """The result of the adjustment.

    Attributes:
        T_first_second: (4, 4) second camera in the first camera's frame, metres.
        covariance: (6, 6) of the right perturbation, rotation first; counts in the calibration.
        inliers: (N,) bool, the points whose six residuals agree with the motion.
        noise_px: standard deviation of one measurement, pixels.
        residual_px: root mean square of the inliers' residuals, pixels.
        calibration: (15,) coefficients, estimated with the motion.
        information: (15, 15) information of this pair of views about them.
    """

    T_first_second: Array
    covariance: Array
    inliers: NDArray[np.bool_]
    noise_px: float
    residual_px: float
    calibration: Array
    information: Array


def estimate_motion(
    tracks: StereoTracks, calibration: Calibration, T_guess: Array, config: AdjustmentConfig | None = None
) -> TwoViewEstimate:
    """Adjust motion, depths and calibration to the tracks, from a guess (4, 4) of T_first_second."""
    config = config or AdjustmentConfig()
    problem = _TwoViewProblem(tracks, calibration, se3.inverse(T_guess))
    sigma = config.initial_noise_px
    for k in range(config.max_iterations):
        start = config.initial_noise_px * 0.5**k
        step = problem.step(max(start, min(sigma, config.initial_noise_px)))
        sigma = max(problem.noise(), config.min_noise_px)
        if start < sigma and np.abs(step).max() < config.convergence_threshold:
            break
    return problem.result(sigma)


def ransac_motion(tracks: StereoTracks, calibration: Calibration) -> Array | None:
    """T_first_second (4, 4) that most tracks agree with, by minimal samples (P3P), or None."""
    camera = calibration.camera
    tracks = tracks.select(tracks.has_depth)
    left, right = calibration.rectify(tracks.first_left, tracks.first_right)
    points = camera.triangulate(left, np.maximum(left[:, 0] - right[:, 0], 0.5))
    try:
        found, w, t, _ = cv2.solvePnPRansac(
            points,
            calibration.undistort(tracks.second_left),
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


class _TwoViewProblem:
    """The state of one adjustment and its Gauss-Newton steps."""

    def __init__(self, tracks: StereoTracks, prior: Calibration, T_second_first: Array) -> None:
        camera = prior.camera
        self._camera = np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.baseline])
        self._pixels, self._factors = tracks.stack_pixels()
        self._freedom = tracks.count_freedom()
        self._prior, self._prior_information = prior, np.linalg.inv(prior.covariance)
        left, right = prior.rectify(tracks.first_left, self._pixels[:, 1])
        self._inverse_depth = clamp_inverse_depth((left[:, 0] - right[:, 0]) / (camera.fx * camera.baseline))
        self._T_second_first, self._calibration = T_second_first, prior.coefficients.copy()
        self._linearize(np.inf)

    def step(self, sigma: float) -> Array:
        """One step with the noise level sigma, pixels; returns the change of the pose (6,)."""
        H, b = self._linearize(sigma)
        H, b = H / sigma**2, b / sigma**2
        H[6:, 6:] += self._prior_information
        b[6:] += self._prior_information @ (self._calibration - self._prior.coefficients)
        change = np.linalg.solve(H + _DAMPING * np.eye(len(H)), -b).astype(np.float64)
        self._inverse_depth = clamp_inverse_depth(self._inverse_depth - self._depth_offset - self._depth_gain @ change)
        self._T_second_first = se3.exp(change[:6]) @ self._T_second_first
        self._calibration = self._calibration + change[6:]
        return change[:6]

    def noise(self) -> float:
        """Measure the standard deviation of a measurement, pixels, by the smaller of the squared residuals."""
        k = int(_QUANTILE * len(self._chi2))
        return float(np.sqrt(np.partition(self._chi2 / _AT_QUANTILE[self._freedom], k)[k]))

    def result(self, sigma: float) -> TwoViewEstimate:
        """Return the result with its uncertainty at the noise level sigma, pixels."""
        self._linearize(sigma)
        inliers = self._chi2 < _LIMIT[self._freedom] * sigma**2
        # All inliers count in full for the uncertainty: the weights only chose them.
        H = self._information(inliers) / sigma**2 + _DAMPING * np.eye(6 + NUM_COEFFICIENTS)
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
            residual_px=self._residual(inliers),
            calibration=self._calibration,
            information=0.5 * (information + information.T),
        )

    def _residual(self, inliers: NDArray[np.bool_]) -> float:
        """Root mean square of the residuals of the inliers, pixels; NaN without any."""
        if not inliers.any():
            return float("nan")
        return float(np.sqrt(self._chi2[inliers].mean() / (1.0 + self._freedom[inliers].mean())))

    def _linearize(self, sigma: float) -> tuple[Array, Array]:
        """Sum up the normal equations (21, 21), (21,); keeps what the depths need."""
        H, b, self._chi2, self._depth_gain, self._depth_offset = build_normal_equations(
            self._camera, (self._pixels, self._factors, self._inverse_depth),
            self._T_second_first, self._calibration, _LIMIT[self._freedom] * sigma**2,
        )  # fmt: skip
        return H, b

    def _information(self, points: NDArray[np.bool_]) -> Array:
        """Hessian (21, 21) of some of the points, all with weight one, pixels squared."""
        H, *_ = build_normal_equations(
            self._camera, (self._pixels[points], self._factors[points], self._inverse_depth[points]),
            self._T_second_first, self._calibration, np.full(int(points.sum()), np.inf),
        )  # fmt: skip
        return H
