"""Sliding-window bundle adjustment: poses and inverse depths of the last few stereo frames.

The oldest pose is fixed, and what leaves the window is forgotten: points are anchored anew in the oldest frame that
still sees them. Memory is bounded by the window. Residuals and Jacobians: docs/math.md, section "Sliding window";
why five frames and no marginal prior: docs/decisions/odometry_window.md.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from odometry import se3
from odometry.camera import StereoCamera, clamp_inverse_depth
from odometry.kernels.sliding_window_equations import build_normal_equations
from odometry.stereo.second_view import RIGHT_IMAGE_NOISE, SecondViewNoise
from odometry.stereo.stereo_self_calibration import Calibration

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_LIMIT = 11.34  # 99 % quantile of chi squared with three degrees of freedom, the residuals of an observation
_MEDIAN = 2.366  # median of the same distribution
_NOISE_AT_FIRST = 0.3  # pixels; the largest that is assumed as well
_DAMPING = 1e-3  # information, 1/rad² and 1/m²: keeps matrices regular


@dataclass(frozen=True)
class WindowConfig:
    """Size of the window and of its adjustment.

    Attributes:
        max_frames: poses in the window; with fewer than three it repeats the two-view adjustment.
        iterations: Gauss-Newton steps for each new frame, which start from the window before.
        min_noise_px: smallest noise level of a measurement that is assumed, pixels.
        min_shared_points: smallest number of points in at least two frames; with fewer nothing is adjusted.
    """

    max_frames: int = 5
    iterations: int = 2
    min_noise_px: float = 0.05
    min_shared_points: int = 20


@dataclass(frozen=True)
class StereoFrameObservations:
    """Points that one stereo pair shows.

    Attributes:
        ids: (N,) growing numbers of the tracks.
        left, right: (N, 2) pixels; NaN on the right where a depth is unknown.
    """

    ids: Indices
    left: Array
    right: Array


@dataclass(frozen=True)
class _Tracks:
    """All points that at least two frames of the window show.

    Attributes:
        first: (N + 1,) first observation of each point, and the end of the last one's.
        frame: (M,) frame of each observation.
        pixels: (M, 3) pixels of a perfect pair: column left, column right, row.
        factor: (M,) of the residual in disparity.
        has_depth: (M,) whether the disparity was measured.
    """

    first: Indices
    frame: Indices
    pixels: Array
    factor: Array
    has_depth: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.first) - 1

    def is_followed(self) -> NDArray[np.bool_]:
        """Which of the observations (M,) are not a point's first."""
        followed = np.ones(len(self.frame), dtype=bool)
        followed[self.first[:-1]] = False
        return followed


class SlidingWindow:
    """The last frames of a stereo odometry, adjusted together."""

    def __init__(self, config: WindowConfig | None = None, noise: SecondViewNoise = RIGHT_IMAGE_NOISE) -> None:
        self._config, self._noise = config or WindowConfig(), noise
        self._frames: list[StereoFrameObservations] = []
        self._poses = np.zeros((0, 4, 4))  # T_oldest_frame
        self._noise_px = _NOISE_AT_FIRST

    def restart(self, first: StereoFrameObservations) -> None:
        """Forget everything but one frame."""
        self._frames, self._poses = [first], np.eye(4)[None]

    def refine(self, observed: StereoFrameObservations, T_last_frame: Array, calibration: Calibration) -> Array:
        """Add a frame and adjust the window.

        Args:
            observed: the new frame's points.
            T_last_frame: (4, 4) its pose in the frame added before, metres, by the two-view adjustment.
            calibration: error of the pair's calibration.

        Returns:
            Its refined pose (4, 4) in the frame added before, at the pose returned for that one.
        """
        if len(self._frames) >= self._config.max_frames:
            self._frames, self._poses = self._frames[1:], _seen_from_first(self._poses[1:])
        stated = self._poses[-1]
        self._frames.append(observed)
        self._poses = np.concatenate([self._poses, (stated @ T_last_frame)[None]])
        tracks = _gather(self._frames, calibration, self._noise)
        if len(tracks) >= self._config.min_shared_points:
            self._adjust(tracks, calibration.camera)
        return se3.inverse(stated) @ self._poses[-1]

    def _adjust(self, tracks: _Tracks, camera: StereoCamera) -> None:
        """Gauss-Newton on all poses but the oldest; changes nothing if it does not converge."""
        intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.baseline])
        observations = (tracks.first, tracks.frame, tracks.pixels, tracks.factor)
        start = tracks.pixels[tracks.first[:-1]]
        depths = clamp_inverse_depth((start[:, 0] - start[:, 1]) / (camera.fx * camera.baseline))
        poses = self._poses
        for _ in range(self._config.iterations):
            scale = _LIMIT * self._noise_px**2
            H, b, chi2, rows, offset = build_normal_equations(intrinsics, observations, depths, poses, scale)
            change = np.zeros(len(b))
            change[6:] = np.linalg.solve(H[6:, 6:] / scale + _DAMPING * np.eye(len(b) - 6), -b[6:] / scale)
            depths = clamp_inverse_depth(depths - offset - rows @ change)
            poses = np.array([T @ se3.exp(xi) for T, xi in zip(poses, change.reshape(-1, 6), strict=True)])
        if np.isfinite(poses).all():
            self._poses = poses
            noise = float(np.sqrt(np.median(chi2[tracks.is_followed() & tracks.has_depth]) / _MEDIAN))
            self._noise_px = min(max(noise, self._config.min_noise_px), _NOISE_AT_FIRST)

    def state(self) -> dict[str, Any]:
        """Frames and poses of the window, for a checkpoint."""
        frames = [dict(vars(frame)) for frame in self._frames]
        return {"frames": frames, "poses": self._poses, "noise_px": self._noise_px}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._frames = [StereoFrameObservations(**frame) for frame in state["frames"]]
        self._poses, self._noise_px = state["poses"], state["noise_px"]


def _seen_from_first(poses: Array) -> Array:
    """Poses (K, 4, 4) in the frame of the first; exact rotations again, as rounding errors double in each round."""
    poses = se3.inverse(poses[0]) @ poses
    poses[:, :3, :3] = Rotation.from_matrix(poses[:, :3, :3]).as_matrix()
    return np.asarray(poses)


def _gather(frames: list[StereoFrameObservations], calibration: Calibration, noise: SecondViewNoise) -> _Tracks:
    """Sort the observations of all frames by point, without points that are seen once."""
    ids = np.concatenate([observed.ids for observed in frames])
    frame = np.repeat(np.arange(len(frames)), [len(observed.ids) for observed in frames])
    seen = np.concatenate([observed.left for observed in frames])
    matched = np.concatenate([observed.right for observed in frames])
    places, factor = noise.weights(seen, matched, fill=True)
    left, right = calibration.rectify(seen, places)
    order = np.argsort(ids, kind="stable")  # stable: each point's observations stay in the order of frames
    _, counts = np.unique(ids, return_counts=True)
    order, counts = order[np.repeat(counts > 1, counts)], counts[counts > 1]
    pixels = np.stack([left[:, 0], right[:, 0], left[:, 1]], axis=1)
    first = np.concatenate([[0], np.cumsum(counts)])
    tracks = _Tracks(first, frame[order], pixels[order], factor[order], np.isfinite(matched[order, 0]))
    # What is expected of an unknown depth is expected once.
    tracks.factor[tracks.is_followed() & ~tracks.has_depth] = 0.0
    return tracks
