"""From a belief to a loop closure: the six degrees of freedom between two images of one place."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.camera import StereoCamera
from odometry.stereo_matching import match_disparity
from place_recognition.belief.matching import mutual_matches
from place_recognition.image_processing.features import SharedFeatures
from slam.loop_geometry import SAME_UNIT, GeometryConfig, RelativePose, Unit, relative_pose

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Disparity = Callable[[Image, Any, Array], Array]  # of left image, right image or None, and pixels (N, 2)
Compare = Callable[[StereoCamera, Array, Array, GeometryConfig], Unit]  # of points (K, 3) of a match and of a query


def same_unit(camera: StereoCamera, points_a: Array, points_b: Array, config: GeometryConfig) -> Unit:
    """Two images of a stereo pair have one unit, the metre."""
    return SAME_UNIT


def _no_pixels() -> NDArray[np.float32]:
    return np.empty((0, 2), np.float32)


@dataclass(frozen=True)
class LoopClosure:
    """A revisit proved by geometry.

    Attributes:
        query, match: frame indices, match < query.
        T_match_query: (4, 4) query camera in the match camera's frame, metres, or the unit of the match's depths.
        covariance: (6, 6) of the right perturbation `T_match_query @ exp(xi)`, rotation first (rad, m).
        inliers: landmarks that agree with the motion.
        matches: landmarks whose descriptors matched; 0 where that is not known.
        pixels_query, pixels_match: (K, 2) where the two left images show the agreeing landmarks.
        unit: of the query's depths, in that of the match's: with one camera the two need not be the same.
    """

    query: int
    match: int
    T_match_query: Array
    covariance: Array
    inliers: int
    matches: int = 0
    pixels_query: NDArray[np.float32] = field(default_factory=_no_pixels)
    pixels_match: NDArray[np.float32] = field(default_factory=_no_pixels)
    unit: Unit = SAME_UNIT


@dataclass(frozen=True)
class Rejection:
    """A proposed revisit that geometry does not bear out.

    Attributes:
        reason: in plain words, with the numbers.
        matches: landmarks whose descriptors matched.
        inliers: of them, those that agreed with one relative pose.
        pixels_query, pixels_match: (K, 2) where the two left images show those.
    """

    reason: str
    matches: int = 0
    inliers: int = 0
    pixels_query: NDArray[np.float32] = field(default_factory=_no_pixels)
    pixels_match: NDArray[np.float32] = field(default_factory=_no_pixels)


Geometry = LoopClosure | Rejection | None  # what geometry said of a belief; None where it was not asked


@dataclass(frozen=True)
class LoopCloserConfig:
    """When two images show one place, and what is kept of each image to find out."""

    max_landmarks: int = 1500  # strongest features kept of an image; 0.3 kB each
    ratio: float = 0.8  # of nearest to second nearest descriptor distance
    min_inliers: int = 20  # landmarks that make a relative pose believable
    min_cells: int = 4  # of the 4 x 4 cells of the query image, those that hold inliers
    agreement_sigma: float = 3.0  # between the poses found forwards and backwards, of the smaller uncertainty
    geometry: GeometryConfig = field(default_factory=GeometryConfig)


@dataclass(frozen=True)
class Landmarks:
    """What is kept of one stereo image: features whose depth is known, strongest first.

    Attributes:
        pixels: (N, 2) float32 in the left image.
        points: (N, 3) float32 metres, camera frame.
        grey: (N,) uint8, brightness of the left image there.
        descriptors: (N, D) float16 of unit length.
    """

    pixels: NDArray[np.float32]
    points: NDArray[np.float32]
    grey: Image
    descriptors: NDArray[np.float16]

    def __len__(self) -> int:
        return len(self.pixels)


class LoopCloser:
    """Remembers the landmarks of stereo images and finds the relative pose of any two of them."""

    def __init__(
        self,
        camera: StereoCamera,
        features: SharedFeatures,
        config: LoopCloserConfig | None = None,
        disparity: Disparity = match_disparity,
        compare: Compare = same_unit,
    ) -> None:
        self._camera, self._features = camera, features
        self._config = config or LoopCloserConfig()
        self._disparity, self._compare = disparity, compare
        self._known: dict[int, Landmarks] = {}

    def remember(self, index: int, left: Image, right: Image | None) -> Landmarks:
        """Find and keep the landmarks of frame `index` from its rectified grey images (H, W)."""
        found = self._features.of(index, left)
        pixels = np.asarray(found.pixels[: self._config.max_landmarks], dtype=np.float64).reshape(-1, 2)
        points = self._camera.triangulate(pixels, self._disparity(left, right, pixels))
        seen = np.isfinite(points).all(axis=1)
        columns, rows = np.rint(pixels[seen]).astype(np.int64).T
        height, width = left.shape
        self._known[index] = Landmarks(
            pixels=pixels[seen].astype(np.float32),
            points=points[seen].astype(np.float32),
            grey=left[rows.clip(0, height - 1), columns.clip(0, width - 1)],
            descriptors=found.descriptors[: self._config.max_landmarks][seen].astype(np.float16),
        )
        return self._known[index]

    def recall(self, index: int, landmarks: Landmarks) -> None:
        """Know frame `index` by landmarks that were found before."""
        self._known[index] = landmarks

    def close(self, query: int, match: int) -> LoopClosure | Rejection:
        """Prove or reject that frame `query` shows the place of the earlier frame `match`.

        Raises:
            ValueError: a frame has not been remembered.
        """
        now, then = self._recall(query), self._recall(match)
        pairs = mutual_matches(
            then.descriptors.astype(np.float32), now.descriptors.astype(np.float32), self._config.ratio
        )
        least = self._config.min_inliers
        if len(pairs) < least:
            return Rejection(f"{len(pairs)} landmarks match, expected at least {least}", len(pairs))
        points_match = then.points[pairs[:, 0]].astype(np.float64)
        points_query = now.points[pairs[:, 1]].astype(np.float64)
        unit = self._compare(self._camera, points_match, points_query, self._config.geometry)
        points_query *= unit.length
        forward = relative_pose(self._camera, points_match, points_query, self._config.geometry)
        backward = relative_pose(self._camera, points_query, points_match, self._config.geometry)
        reason = self._doubt(forward, backward, now.pixels[pairs[:, 1]])
        agreeing = pairs[:0] if forward is None else pairs[forward.inliers]
        pixels_query, pixels_match = now.pixels[agreeing[:, 1]], then.pixels[agreeing[:, 0]]
        if reason or forward is None:
            return Rejection(reason, len(pairs), len(agreeing), pixels_query, pixels_match)
        return LoopClosure(
            query=query,
            match=match,
            T_match_query=forward.T_a_b,
            covariance=forward.covariance,
            inliers=len(agreeing),
            matches=len(pairs),
            unit=unit,
            pixels_query=pixels_query,
            pixels_match=pixels_match,
        )

    def _recall(self, index: int) -> Landmarks:
        if index not in self._known:
            raise ValueError(f"expected a frame that was remembered, got {index}; call remember({index}, ...) first")
        return self._known[index]

    def _doubt(self, forward: RelativePose | None, backward: RelativePose | None, pixels: NDArray[np.float32]) -> str:
        """Why not to believe a pose; empty where there is no reason."""
        if forward is None or backward is None:
            return "no relative pose stands out among the landmark matches"
        config, inliers = self._config, int(forward.inliers.sum())
        if inliers < config.min_inliers:
            return f"{inliers} landmarks agree with one relative pose, expected at least {config.min_inliers}"
        cells = self._cells(pixels[forward.inliers])
        if cells < config.min_cells:
            return f"the {inliers} agreeing landmarks lie in {cells} of 16 cells, expected {config.min_cells}"
        difference = se3.log(forward.T_a_b @ backward.T_a_b)
        sigmas = float(np.sqrt(difference @ np.linalg.solve(forward.covariance, difference)))
        if sigmas > config.agreement_sigma:
            distance = float(np.linalg.norm(difference[3:]))
            return f"poses found forwards and backwards differ by {distance:.2f} m, {sigmas:.1f} sigma"
        return ""

    def _cells(self, pixels: NDArray[np.float32]) -> int:
        """How many cells of a 4 x 4 grid over the image hold one of the pixels (K, 2)."""
        size = np.array([self._camera.width, self._camera.height])
        cell = np.clip(4 * pixels / size, 0, 3).astype(np.int64)
        return len(np.unique(cell @ [1, 4]))
