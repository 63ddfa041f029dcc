"""Front end of the monocular odometry: corners of one camera, followed from image to image."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odometry.klt_tracking import (
    TrackingConfig,
    detect_corners,
    is_inside,
    is_unmasked,
    match_brightness,
    track_points,
)

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]
Image = NDArray[np.uint8]


@dataclass(frozen=True)
class MonoTracks:
    """Tracked points of one image.

    Attributes:
        image: (H, W) uint8.
        ids: (N,) growing numbers of the tracks.
        pixels: (N, 2) places of the points in the image.
        reference_pixels: (N, 2) their places in the last reference frame.
        reference_image: (H, W) uint8, image of the last reference frame.
        reference_count: points that the last reference frame showed.
    """

    image: Image
    ids: Indices
    pixels: Array
    reference_pixels: Array
    reference_image: Image
    reference_count: int = 0

    def __len__(self) -> int:
        return len(self.ids)

    def select(self, chosen: Mask) -> "MonoTracks":
        """Return some of the points, chosen by (N,) bool."""
        return replace(
            self, ids=self.ids[chosen], pixels=self.pixels[chosen], reference_pixels=self.reference_pixels[chosen]
        )

    def merge(self, ids: Indices, pixels: Array) -> "MonoTracks":
        """These points and others (M,) at pixels (M, 2), in the order of their numbers."""
        order = np.argsort(np.concatenate([self.ids, ids]), kind="stable")
        return replace(
            self,
            ids=np.concatenate([self.ids, ids])[order],
            pixels=np.concatenate([self.pixels, pixels])[order],
            reference_pixels=np.concatenate([self.reference_pixels, pixels])[order],
        )


@dataclass(frozen=True)
class FollowedTracks:
    """Points that were found again in a second image.

    Attributes:
        tracks: the M points that were found, in the second image.
        before: (M, 2) pixels of the same points in the first image.
    """

    tracks: MonoTracks
    before: Array


class MonoFrontEnd:
    """Detects corners, numbers their tracks and follows them.

    Attributes:
        mask: (H, W) uint8, 0 where the image shows no scene but the vehicle or a text; None for nowhere.
    """

    def __init__(self, config: TrackingConfig) -> None:
        self._config, self._count = config, 0
        self.mask: Image | None = None

    def observe(self, image: Image, kept: MonoTracks | None = None) -> MonoTracks:
        """Make a reference frame of the points kept, topped up with new corners."""
        ids, pixels = (np.zeros(0, np.int64), np.zeros((0, 2))) if kept is None else (kept.ids, kept.pixels)
        corners = detect_corners(image, pixels, self._config, self.mask)
        ids = np.concatenate([ids, self._count + np.arange(len(corners))])
        pixels = np.concatenate([pixels, corners])
        self._count += len(corners)
        image = image.copy()  # callers may use one buffer for all images
        return MonoTracks(image, ids, pixels, pixels, image, len(ids))

    def follow(self, tracks: MonoTracks, image: Image, ahead: Array, wide: bool = False) -> FollowedTracks:
        """Look for points in the next image near where they are expected, pixels (N, 2), NaN where that is unknown."""
        config = self._config.widen() if wide else self._config
        visible = np.isfinite(ahead[:, 0]) & is_inside(ahead, image)
        start = np.where(visible[:, None], ahead, tracks.pixels)
        lit = match_brightness(tracks.image, image) if wide else image
        pixels = track_points((tracks.image, lit), tracks.pixels, start, config)
        found = np.isfinite(pixels[:, 0]) & is_unmasked(pixels, self.mask)
        there = replace(tracks.select(found), image=image.copy(), pixels=pixels[found])
        return FollowedTracks(there, tracks.pixels[found])

    def state(self) -> dict[str, Any]:
        """How many tracks have been named, for a checkpoint."""
        return {"num_tracks": self._count}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._count = state["num_tracks"]
