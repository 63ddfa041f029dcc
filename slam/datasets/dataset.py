"""What a recorded drive is, wherever it came from."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from odometry.camera import StereoCamera
from place_recognition.image_processing.features import FeatureExtractor, LocalFeatures


@dataclass(frozen=True)
class Frame:
    """One moment of a drive.

    Attributes:
        index: position in the drive, from 0.
        timestamp: seconds.
        left: (H, W) uint8, grey, rectified.
        right: (H, W) uint8, or None in a drive with one camera.
        features: local features of the left image; None until somebody has extracted them.
    """

    index: int
    timestamp: float
    left: NDArray[np.uint8]
    right: NDArray[np.uint8] | None
    features: LocalFeatures | None = None

    def with_features(self, extractor: FeatureExtractor) -> "Frame":
        """Return the frame with the features of its left image; itself where it has them."""
        return self if self.features is not None else replace(self, features=extractor.extract(self.left))


class Dataset(Protocol):
    """A recorded drive. Images are read when asked for; everything else is checked when it is opened."""

    @property
    def name(self) -> str:
        """Short name for titles and files."""
        ...

    @property
    def camera(self) -> StereoCamera:
        """Intrinsics and baseline of the rectified pair."""
        ...

    @property
    def timestamps(self) -> NDArray[np.float64]:
        """(N,) seconds, increasing."""
        ...

    @property
    def ground_truth(self) -> NDArray[np.float64] | None:
        """T_world_camera (N, 4, 4), metres, or None where it is not known."""
        ...

    @property
    def has_right(self) -> bool:
        """Whether there is a right image for each left one."""
        ...

    @property
    def remarks(self) -> tuple[str, ...]:
        """What was left out, or taken for granted, when the drive was opened."""
        ...

    def __len__(self) -> int: ...

    def __getitem__(self, index: int) -> Frame: ...

    def __iter__(self) -> Iterator[Frame]: ...
