"""Front end of the stereo odometry: corners of a pair of images, followed to the next pair."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.klt_tracking import (
    TrackingConfig,
    blur,
    detect_corners,
    is_inside,
    is_unmasked,
    match_brightness,
    track_points,
)
from odometry.stereo.second_view import RIGHT_IMAGE_NOISE, Pair, SecondView
from odometry.stereo.sliding_window import StereoFrameObservations
from odometry.stereo.stereo_self_calibration import Calibration
from odometry.stereo.two_view_adjustment import StereoTracks

Array = NDArray[np.float64]
Image = NDArray[np.uint8]


@dataclass(frozen=True)
class StereoObservation:
    """A stereo pair and its tracked points.

    Attributes:
        pair: left image (H, W) uint8, and the right image or the depth image.
        points: points that are followed from this pair.
    """

    pair: Pair
    points: StereoFrameObservations

    def state(self) -> dict[str, Any]:
        """Images and points, for a checkpoint."""
        return {"left": self.pair[0], "right": self.pair[1], "points": dict(vars(self.points))}

    @classmethod
    def from_state(cls, state: dict[str, Any]) -> "StereoObservation":
        """The view of a state."""
        return cls((state["left"], state["right"]), StereoFrameObservations(**state["points"]))


class StereoFrontEnd:
    """Detects corners, numbers their tracks and follows them.

    Attributes:
        mask: (H, W) uint8, 0 where the left image shows no scene but the vehicle or a text; None for nowhere. The
            second view needs none: its points are sought from those of the left image.
        second_view: what finds points in the right image, or reads them in a depth image.
    """

    def __init__(self, tracking: TrackingConfig, second_view: SecondView) -> None:
        self._tracking, self.second_view = tracking, second_view
        self._count = 0
        self.mask: Image | None = None

    def observe(self, pair: Pair, kept: StereoFrameObservations | None = None) -> StereoObservation:
        """Observe a pair: the points kept, topped up with new corners that the second view shows as well."""
        kept = kept or StereoFrameObservations(np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2)))
        corners = detect_corners(pair[0], kept.left, self._tracking, self.mask)
        places = self.second_view.find(pair, corners)
        matched = self.second_view.are_usable(places)
        ids = self._count + np.arange(int(matched.sum()))
        self._count += len(ids)
        points = StereoFrameObservations(
            np.concatenate([kept.ids, ids]),
            np.concatenate([kept.left, corners[matched]]),
            np.concatenate([kept.right, places[matched]]),
        )
        return StereoObservation((pair[0].copy(), pair[1].copy()), points)  # callers may use one buffer for all images

    def follow(
        self, view: StereoObservation, pair: Pair, guess: Array, calibration: Calibration, wide: bool = False
    ) -> StereoTracks:
        """Follow the points of a view to a pair of images, from where a guess (4, 4) of T_view_pair puts them."""
        points, tracking = view.points, self._tracking.widen() if wide else self._tracking
        ahead, shift = _predict(points, guess, calibration, pair[0])
        # A wider search also allows for another exposure, as at the end of a tunnel.
        left = match_brightness(view.pair[0], pair[0]) if wide else pair[0]
        images = view.pair[0], left
        if wide and tracking.wide_blur_px:
            images = blur(images[0], tracking.wide_blur_px), blur(images[1], tracking.wide_blur_px)
        second_left = track_points(images, points.left, ahead, tracking)
        # What the prediction got wrong in the left image it got wrong in the right one too.
        start = second_left + shift
        kept = np.flatnonzero(np.isfinite(start[:, 0]) & is_unmasked(second_left, self.mask))
        second_right = self.second_view.follow(pair, second_left[kept], start[kept])
        matched = self.second_view.are_usable(second_right)
        kept, second_right = kept[matched], second_right[matched]
        return StereoTracks(
            points.left[kept], points.right[kept], second_left[kept], second_right, points.ids[kept],
            self.second_view.noise,
        )  # fmt: skip

    def is_swapped(self, pair: Pair) -> bool:
        """Whether left and right image are swapped: whether far more points match the other way round."""
        return self.second_view.is_swapped(pair, self._detect)

    def _detect(self, image: Image) -> Array:
        return detect_corners(image, np.zeros((0, 2)), self._tracking, self.mask)

    def state(self) -> dict[str, Any]:
        """Number of tracks that have got an id, for a checkpoint."""
        return {"num_tracks": self._count}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._count = state["num_tracks"]


def _predict(
    points: StereoFrameObservations, guess: Array, calibration: Calibration, image: Image
) -> tuple[Array, Array]:
    """Predicted places (N, 2) of the points in the new left image, and right less left (N, 2), pixels."""
    places, _ = RIGHT_IMAGE_NOISE.weights(points.left, points.right)
    left, right = calibration.rectify(points.left, places)
    disparity, camera = left[:, 0] - right[:, 0], calibration.camera
    seen = camera.project(se3.transform(se3.inverse(guess), camera.triangulate(left, np.maximum(disparity, 0.1))))
    # Distortion changes slowly over the image: what the point had before, it has now.
    ahead, shift = seen[:, [0, 2]] + (points.left - left), places - points.left
    visible = np.isfinite(ahead[:, 0]) & is_inside(ahead, image)
    shift[:, 0] += np.where(visible, seen[:, 1] - seen[:, 0] + disparity, 0.0)
    return np.where(visible[:, None], ahead, points.left), shift
