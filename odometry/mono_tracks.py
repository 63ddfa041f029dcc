"""Points of one camera, followed from image to image."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odometry.light import in_light_of
from odometry.tracking import TrackingConfig, detect, follow, inside

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]
Image = NDArray[np.uint8]


@dataclass(frozen=True)
class Tracks:
    """What one image shows of the points that are followed.

    Attributes:
        image: (H, W) uint8.
        ids: (N,) names, growing.
        pixels: (N, 2) where they are.
        key_pixels: (N, 2) where they were in the last key frame.
        key_image: (H, W) uint8 that one's.

    """

    image: Image
    ids: Indices
    pixels: Array
    key_pixels: Array
    key_image: Image

    def __len__(self) -> int:
        return len(self.ids)

    def only(self, chosen: Mask) -> "Tracks":
        """Return some of the points, chosen by (N,) bool."""
        return replace(self, ids=self.ids[chosen], pixels=self.pixels[chosen], key_pixels=self.key_pixels[chosen])


@dataclass(frozen=True)
class Followed:
    """Points that a second image shows again.

    Attributes:
        tracks: (M points) in the second image.
        before: (M, 2) pixels in the first.

    """

    tracks: Tracks
    before: Array


class MonoFrontEnd:
    """Detects points, names their tracks and follows them."""

    def __init__(self, config: TrackingConfig) -> None:
        self._config, self._named = config, 0

    def observe(self, image: Image, kept: Tracks | None = None) -> Tracks:
        """Make a key frame of the points kept, topped up with new corners."""
        ids, pixels = (np.zeros(0, np.int64), np.zeros((0, 2))) if kept is None else (kept.ids, kept.pixels)
        corners = detect(image, pixels, self._config)
        ids = np.concatenate([ids, self._named + np.arange(len(corners))])
        pixels = np.concatenate([pixels, corners])
        self._named += len(corners)
        image = image.copy()  # callers may use one buffer for all images
        return Tracks(image, ids, pixels, pixels, image)

    def follow(self, tracks: Tracks, image: Image, ahead: Array, wide: bool = False) -> Followed:
        """Look for points in the next image near where they are expected, pixels (N, 2), NaN where that is unknown."""
        config = self._config.wider() if wide else self._config
        visible = np.isfinite(ahead[:, 0]) & inside(ahead, image)
        start = np.where(visible[:, None], ahead, tracks.pixels)
        lit = in_light_of(tracks.image, image) if wide else image
        pixels = follow((tracks.image, lit), tracks.pixels, start, config)
        found = np.isfinite(pixels[:, 0])
        there = Tracks(image.copy(), tracks.ids[found], pixels[found], tracks.key_pixels[found], tracks.key_image)
        return Followed(there, tracks.pixels[found])

    def state(self) -> dict[str, Any]:
        """How many tracks have been named, for a checkpoint."""
        return {"num_tracks": self._named}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._named = state["num_tracks"]
