"""Local map of one camera: earlier frames whose landmarks are found again when the camera looks that way once more.

The bundle forgets what leaves it. A camera in a hand, or on a robot that turns on the spot, soon sees the same things
again, and their depths hold the scale and the pose. Frames that leave the bundle are kept here, few for each view.
Reasons and figures: docs/decisions/mono_any_motion.md.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.distortion import LensDistortion
from odometry.klt_tracking import TrackingConfig, is_inside, is_unmasked, match_brightness, track_points

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]

_MAX_FRAMES = 40
_MIN_LANDMARKS = 20  # landmarks of known depth of a frame that is kept, and that are found again
# Views as near as this, in median depths and radians, show the tracker the same things.
_MAX_DISTANCE, _MAX_ANGLE_RAD = 0.3, 0.5
_SAME_VIEW = 0.3
# Recognition: frames that are tried, size of a glance, corners and size of their patches, samples of RANSAC.
_MAX_TRIED, _GLANCE, _MAX_CORNERS, _PATCH_PX, _SAMPLES = 3, (32, 24), 1000, 31, 500
_MAX_OFFSET_PX = 3.0  # of a landmark found again, from the median of all: the pose may have drifted, by more than that


@dataclass(frozen=True)
class MapFrame:
    """A frame of the map with its landmarks of known depth.

    Attributes:
        number: of the frame.
        image: (H, W) uint8.
        T_map_camera: (4, 4).
        ids: (N,) numbers of its landmarks, growing.
        pixels: (N, 2) where its image shows them.
        inverse_depth: (N,) in its camera.
        information: (N,) about the inverse depth, pixels squared over its unit squared.
    """

    number: int
    image: Image
    T_map_camera: Array
    ids: Indices
    pixels: Array
    inverse_depth: Array
    information: Array

    def rescale(self, factor: float, center: Array) -> "MapFrame":
        """Make the map larger by a factor around a center (3,)."""
        T = self.T_map_camera.copy()
        T[:3, 3] = center + factor * (T[:3, 3] - center)
        values = vars(self) | {
            "T_map_camera": T,
            "inverse_depth": self.inverse_depth / factor,
            "information": self.information * factor**2,
        }
        return MapFrame(**values)


@dataclass(frozen=True)
class FoundLandmarks:
    """Landmarks of an earlier frame that an image shows again.

    Attributes:
        frame: the earlier frame.
        ids: (M,) numbers of the landmarks, growing.
        pixels: (M, 2) where the image shows them.
    """

    frame: MapFrame
    ids: Indices
    pixels: Array


class LocalMap:
    """Keeps earlier frames and finds their landmarks again."""

    def __init__(self, tracking: TrackingConfig) -> None:
        self._tracking = tracking
        self._frames: list[MapFrame] = []

    def keep(self, frame: MapFrame, T_map_staying: Array | None = None) -> None:
        """Keep a frame, unless one is kept, or stays in the bundle at (4, 4), that shows the same view."""
        if T_map_staying is not None and _distance(T_map_staying, frame) <= _SAME_VIEW:
            return
        if len(frame.ids) >= _MIN_LANDMARKS and all(
            _distance(frame.T_map_camera, kept) > _SAME_VIEW for kept in self._frames
        ):
            self._frames = [*self._frames, frame][-_MAX_FRAMES:]

    def forget(self) -> None:
        """Begin again with nothing."""
        self._frames = []

    def rescale(self, factor: float, center: Array) -> None:
        """Make the map larger by a factor around a center (3,)."""
        if factor != 1.0:
            self._frames = [frame.rescale(factor, center) for frame in self._frames]

    def find(
        self,
        image: Image,
        T_map_camera: Array,
        tracked: Indices,
        lens: LensDistortion,
        mask: Image | None,
        others: list[MapFrame],
    ) -> FoundLandmarks | None:
        """Find landmarks of the nearest view again in an image at a pose (4, 4) that is nearly right; None if too few.

        Args:
            image: (H, W) uint8.
            T_map_camera: (4, 4).
            tracked: (N,) numbers of landmarks that need not be found.
            lens: of the camera.
            mask: (H, W) uint8, 0 where the image shows no scene.
            others: frames to look at beside those that are kept.
        """
        frames = [frame for frame in (*self._frames, *others) if len(frame.ids) >= _MIN_LANDMARKS]
        near = [_distance(T_map_camera, frame) for frame in frames]
        if min(near, default=np.inf) > 1.0:
            return None
        frame = frames[int(np.argmin(near))]
        rays, T = lens.rays(frame.pixels), se3.inverse(T_map_camera) @ frame.T_map_camera
        ahead = lens.pixels(rays @ T[:3, :3].T + frame.inverse_depth[:, None] * T[:3, 3])
        wanted = ~np.isin(frame.ids, tracked) & np.isfinite(ahead[:, 0])
        wanted &= is_inside(np.nan_to_num(ahead), image)
        if wanted.sum() < _MIN_LANDMARKS:
            return None
        lit = match_brightness(frame.image, image)
        pixels = track_points((frame.image, lit), frame.pixels[wanted], ahead[wanted], self._tracking)
        found = np.isfinite(pixels[:, 0]) & is_unmasked(pixels, mask)
        if found.sum() < _MIN_LANDMARKS:
            return None
        off = pixels - ahead[wanted]
        found[found] = np.linalg.norm(off[found] - np.median(off[found], axis=0), axis=1) < _MAX_OFFSET_PX
        if found.sum() < _MIN_LANDMARKS:
            return None
        return FoundLandmarks(frame, frame.ids[wanted][found], pixels[found])

    def recognize(self, image: Image, lens: LensDistortion, others: list[MapFrame]) -> tuple[MapFrame, Array] | None:
        """Find the view that an image shows, wherever it was taken; its frame and T_frame_camera (4, 4), or None.

        Args:
            image: (H, W) uint8.
            lens: of the camera.
            others: frames to look at beside those that are kept.
        """
        frames = [frame for frame in (*others[::-1], *self._frames[::-1]) if len(frame.ids) >= _MIN_LANDMARKS]
        likeness = np.array([_likeness(image, frame.image) for frame in frames])
        for k in np.argsort(-likeness, kind="stable")[:_MAX_TRIED]:
            T = _locate(image, frames[k], lens)
            if T is not None:
                return frames[k], T
        return None

    def state(self) -> dict[str, Any]:
        """The frames, for a checkpoint."""
        return {"frames": [dict(vars(frame)) for frame in self._frames]}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._frames = [MapFrame(**frame) for frame in state["frames"]]


def _likeness(image: Image, other: Image) -> float:
    """Correlation of two images at a glance."""
    small = [
        cv2.resize(each, _GLANCE, interpolation=cv2.INTER_AREA).astype(np.float64).ravel() for each in (image, other)
    ]
    one, two = (each - each.mean() for each in small)
    return float(one @ two / max(float(np.linalg.norm(one) * np.linalg.norm(two)), 1e-9))


def _locate(image: Image, frame: MapFrame, lens: LensDistortion) -> Array | None:
    """Pose T_frame_camera (4, 4) of an image by upright descriptors of a frame's landmarks; None if too few agree."""
    orb = cv2.ORB.create(nfeatures=_MAX_CORNERS, nlevels=1)
    corners = orb.detect(image, None)
    landmarks = [cv2.KeyPoint(float(x), float(y), _PATCH_PX, 0.0, 0.0, 0, k) for k, (x, y) in enumerate(frame.pixels)]
    corners = [cv2.KeyPoint(corner.pt[0], corner.pt[1], _PATCH_PX, 0.0) for corner in corners]
    corners_seen, seen = orb.compute(image, corners)
    landmarks_known, known = orb.compute(frame.image, landmarks)
    if seen is None or known is None:
        return None
    matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(known, seen)
    which = np.array([landmarks_known[match.queryIdx].class_id for match in matches], dtype=np.int64)
    if len(which) < _MIN_LANDMARKS:
        return None
    points = lens.rays(frame.pixels[which]) / frame.inverse_depth[which, None]
    slopes = lens.rays(np.array([corners_seen[match.trainIdx].pt for match in matches]))[:, :2]
    try:
        found, w, t, agree = cv2.solvePnPRansac(
            points, slopes, np.eye(3), None, iterationsCount=_SAMPLES,
            reprojectionError=_MAX_OFFSET_PX / lens.camera.fx, flags=cv2.SOLVEPNP_AP3P,
        )  # fmt: skip
    except cv2.error:  # thrown on degenerate configurations
        return None
    if not found or agree is None or len(agree) < _MIN_LANDMARKS:
        return None
    T = se3.inverse(se3.pose(cv2.Rodrigues(w)[0], t[:, 0]))
    return T if np.isfinite(T).all() else None


def _distance(T_map_camera: Array, frame: MapFrame) -> float:
    """How different two views are: 1 at the largest distance, or angle, at which landmarks are looked for."""
    T = se3.inverse(frame.T_map_camera) @ T_map_camera
    parallax = float(np.linalg.norm(T[:3, 3]) * np.median(frame.inverse_depth))
    return max(parallax / _MAX_DISTANCE, se3.angle(T) / _MAX_ANGLE_RAD)
