"""Loop closing: from a matched image to a loop closure with six degrees of freedom."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.camera import StereoCamera
from place_recognition.image_processing.local_features import LocalFeatures
from place_recognition.image_processing.matching import mutual_matches
from slam.loop_closing.relative_pose import (
    UNIT_SCALE,
    RelativePose,
    RelativePoseConfig,
    ScaleRatio,
    estimate_relative_scale,
    measure_depth_noise,
    relative_pose,
)

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
# Camera, points (K, 3) of the match and of the query, settings -> scale of the query in that of the match
ScaleEstimator = Callable[[StereoCamera, Array, Array, RelativePoseConfig], ScaleRatio]
# The same -> settings with the noise of these landmarks
NoiseEstimator = Callable[[StereoCamera, Array, Array, RelativePoseConfig], RelativePoseConfig]

_GRID = 4  # cells of the query image in each direction, over which inliers must be spread


def fixed_scale(camera: StereoCamera, points_a: Array, points_b: Array, config: RelativePoseConfig) -> ScaleRatio:
    """Scale of two stereo images: both measure metres."""
    return UNIT_SCALE


def pair_noise(
    camera: StereoCamera, points_a: Array, points_b: Array, config: RelativePoseConfig
) -> RelativePoseConfig:
    """Noise of the landmarks of two stereo images: that of any pair."""
    return config


class DepthSource(Protocol):
    """Depth of the frame that was processed last: the part of a visual odometry that closing loops needs."""

    @property
    def has_metric_scale(self) -> bool:
        """Whether the depths of all frames have one unit of length."""
        ...

    def disparity(self, left: Image, right: Image | None, pixels: Array) -> Array:
        """Disparity (N,), pixels, at pixels (N, 2) of the left image; NaN where it is unknown."""
        ...


def _no_pixels() -> NDArray[np.float32]:
    return np.empty((0, 2), np.float32)


@dataclass(frozen=True)
class LoopClosure:
    """A revisit with a relative pose, on which the landmarks of the two images agree.

    Attributes:
        query, match: frame indices; the match is the earlier one.
        T_match_query: (4, 4) query camera in the match camera's frame, in metres, with one camera in the match's unit.
        covariance: (6, 6) of the right perturbation `T_match_query @ exp(xi)`, rotation first (rad, m).
        inliers: number of landmarks that agree with the relative pose.
        matches: number of landmarks whose descriptors match; 0 if unknown.
        pixels_query, pixels_match: (K, 2) pixels of the inliers in the two left images.
        scale: scale of the query's depths in that of the match's; differs from one with one camera only.
    """

    query: int
    match: int
    T_match_query: Array
    covariance: Array
    inliers: int
    matches: int = 0
    pixels_query: NDArray[np.float32] = field(default_factory=_no_pixels)
    pixels_match: NDArray[np.float32] = field(default_factory=_no_pixels)
    scale: ScaleRatio = UNIT_SCALE


@dataclass(frozen=True)
class Rejection:
    """A proposed revisit for which no relative pose was accepted.

    Attributes:
        reason: why it was rejected, a sentence with the numbers.
        matches: number of landmarks whose descriptors match.
        inliers: number of these that agree with one relative pose.
        pixels_query, pixels_match: (K, 2) pixels of the inliers in the two left images.
    """

    reason: str
    matches: int = 0
    inliers: int = 0
    pixels_query: NDArray[np.float32] = field(default_factory=_no_pixels)
    pixels_match: NDArray[np.float32] = field(default_factory=_no_pixels)


# Result of the geometric verification of a belief; None if it was not verified
LoopVerification = LoopClosure | Rejection | None


@dataclass(frozen=True)
class LoopCloserConfig:
    """When a loop is accepted, and how many landmarks are kept of each image.

    Attributes:
        max_landmarks: maximum number of features kept of an image, the strongest ones; 0.3 kB each.
        max_known_landmarks: the same for an image of a place that the map has in full; `revisit reprocess` finds its
            loop again by these.
        ratio: maximum ratio of nearest to second nearest descriptor distance.
        min_inliers: minimum number of landmarks that agree with a relative pose.
        min_cells: minimum number of cells with inliers, of the 4 x 4 cells of the query image.
        max_disagreement_sigma: maximum difference of the poses found forwards and backwards, by the covariance of one.
        relative_pose: settings of the relative pose.
    """

    max_landmarks: int = 1500
    max_known_landmarks: int = 100
    ratio: float = 0.8
    min_inliers: int = 20
    min_cells: int = 4
    max_disagreement_sigma: float = 3.0
    relative_pose: RelativePoseConfig = field(default_factory=RelativePoseConfig)


@dataclass(frozen=True)
class FrameLandmarks:
    """Landmarks of one frame: features with depth, strongest first.

    Attributes:
        pixels: (N, 2) float32, in the left image.
        points: (N, 3) float32, metres, camera frame.
        grey: (N,) uint8, brightness of the left image at the pixels.
        descriptors: (N, D) float16, of unit length.
    """

    pixels: NDArray[np.float32]
    points: NDArray[np.float32]
    grey: Image
    descriptors: NDArray[np.float16]

    def __len__(self) -> int:
        return len(self.pixels)

    def strongest(self, count: int) -> "FrameLandmarks":
        """The `count` strongest landmarks."""
        return FrameLandmarks(  # copies, as views would keep the rest
            pixels=self.pixels[:count].copy(),
            points=self.points[:count].copy(),
            grey=self.grey[:count].copy(),
            descriptors=self.descriptors[:count].copy(),
        )


class LoopCloser:
    """Keeps the landmarks of all frames and finds the relative pose of any two of them."""

    def __init__(
        self,
        camera: StereoCamera,
        depth: DepthSource,
        config: LoopCloserConfig | None = None,
    ) -> None:
        self._camera = camera
        self._config = config or LoopCloserConfig()
        self._depth = depth
        self._measure_noise: NoiseEstimator = pair_noise if depth.has_metric_scale else measure_depth_noise
        self._estimate_scale: ScaleEstimator = fixed_scale if depth.has_metric_scale else estimate_relative_scale
        self._landmarks: dict[int, FrameLandmarks] = {}

    def extract_landmarks(
        self, index: int, features: LocalFeatures, left: Image, right: Image | None
    ) -> FrameLandmarks:
        """Find the landmarks of frame `index`, which the depth source has tracked last.

        Args:
            index: number of the frame.
            features: features of its left image.
            left: its left image (H, W), rectified and grey.
            right: its right image, likewise; None where there is none.
        """
        pixels = np.asarray(features.pixels[: self._config.max_landmarks], dtype=np.float64).reshape(-1, 2)
        points = self._camera.triangulate(pixels, self._depth.disparity(left, right, pixels))
        has_depth = np.isfinite(points).all(axis=1)
        columns, rows = np.rint(pixels[has_depth]).astype(np.int64).T
        height, width = left.shape
        return FrameLandmarks(
            pixels=pixels[has_depth].astype(np.float32),
            points=points[has_depth].astype(np.float32),
            grey=left[rows.clip(0, height - 1), columns.clip(0, width - 1)],
            descriptors=features.descriptors[: self._config.max_landmarks][has_depth].astype(np.float16),
        )

    def add_frame(self, index: int, landmarks: FrameLandmarks) -> None:
        """Keep the landmarks of frame `index`."""
        self._landmarks[index] = landmarks

    def forget(self, index: int) -> None:
        """Keep no landmarks of frame `index`: it is matched with no other one any more."""
        self._landmarks[index] = self._landmarks_of(index).strongest(0)

    def verify(self, query: int, match: int) -> LoopClosure | Rejection:
        """Find the relative pose of frame `query` in the earlier frame `match`, or reject the match.

        Raises:
            ValueError: a frame has not been added.
        """
        now, then = self._landmarks_of(query), self._landmarks_of(match)
        pairs = mutual_matches(
            then.descriptors.astype(np.float32), now.descriptors.astype(np.float32), self._config.ratio
        )
        min_inliers = self._config.min_inliers
        if len(pairs) < min_inliers:
            return Rejection(f"{len(pairs)} landmarks match, expected at least {min_inliers}", len(pairs))
        points_match = then.points[pairs[:, 0]].astype(np.float64)
        points_query = now.points[pairs[:, 1]].astype(np.float64)
        scale = self._estimate_scale(self._camera, points_match, points_query, self._config.relative_pose)
        points_query *= scale.ratio
        # Both directions: the matches of a false loop seldom give one pose and its inverse.
        noise = self._measure_noise(self._camera, points_match, points_query, self._config.relative_pose)
        forward = relative_pose(self._camera, points_match, points_query, noise)
        backward = relative_pose(self._camera, points_query, points_match, noise)
        reason = self._rejection_reason(forward, backward, now.pixels[pairs[:, 1]])
        agreeing = pairs[:0] if forward is None else pairs[forward.inliers]
        pixels_query, pixels_match = now.pixels[agreeing[:, 1]], then.pixels[agreeing[:, 0]]
        if forward is None or reason is not None:
            return Rejection(reason or "", len(pairs), len(agreeing), pixels_query, pixels_match)
        return LoopClosure(
            query=query,
            match=match,
            T_match_query=forward.T_a_b,
            covariance=forward.covariance,
            inliers=len(agreeing),
            matches=len(pairs),
            scale=scale,
            pixels_query=pixels_query,
            pixels_match=pixels_match,
        )

    def _landmarks_of(self, index: int) -> FrameLandmarks:
        if index not in self._landmarks:
            raise ValueError(f"expected a frame that was added, got {index}; call add_frame({index}, ...) first")
        return self._landmarks[index]

    def _rejection_reason(
        self, forward: RelativePose | None, backward: RelativePose | None, pixels: NDArray[np.float32]
    ) -> str | None:
        """Why a relative pose is rejected, with the query's matched pixels (K, 2); None if it is accepted."""
        if forward is None or backward is None:
            return "no relative pose stands out among the landmark matches"
        config, inliers = self._config, int(forward.inliers.sum())
        if inliers < config.min_inliers:
            return f"{inliers} landmarks agree with one relative pose, expected at least {config.min_inliers}"
        cells = self._cells(pixels[forward.inliers])
        if cells < config.min_cells:
            return f"the {inliers} agreeing landmarks lie in {cells} of {_GRID**2} cells, expected {config.min_cells}"
        difference = se3.log(forward.T_a_b @ backward.T_a_b)
        sigmas = float(np.sqrt(difference @ np.linalg.solve(forward.covariance, difference)))
        if sigmas > config.max_disagreement_sigma:
            distance = float(np.linalg.norm(difference[3:]))
            return f"poses found forwards and backwards differ by {distance:.2f} m, {sigmas:.1f} sigma"
        return None

    def _cells(self, pixels: NDArray[np.float32]) -> int:
        """Number of cells of a grid over the image that hold one of the pixels (K, 2)."""
        size = np.array([self._camera.width, self._camera.height])
        cell = np.clip(_GRID * pixels / size, 0, _GRID - 1).astype(np.int64)
        return len(np.unique(cell @ [1, _GRID]))
