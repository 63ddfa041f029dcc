"""The interface of a dataset: what every format provides once it is opened."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from odometry.camera import StereoCamera
from place_recognition.image_processing.features import FeatureExtractor, LocalFeatures


@dataclass(frozen=True)
class Frame:
    """One rectified stereo pair, or one image of a dataset with one camera.

    Attributes:
        index: position in the dataset, from 0.
        timestamp: time of exposure, seconds.
        left: (H, W) uint8, grey, rectified.
        right: (H, W) uint8, or None in a dataset with one camera.
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
    """A recorded sequence of frames. Images are read on demand; all other files are checked on opening."""

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
        """T_world_camera (N, 4, 4), metres, or None where it is unknown."""
        ...

    @property
    def has_right(self) -> bool:
        """Whether there is a right image for each left image."""
        ...

    @property
    def remarks(self) -> tuple[str, ...]:
        """Notes for the user about images that were left out and assumptions that were made on opening."""
        ...

    def __len__(self) -> int: ...

    def __getitem__(self, index: int) -> Frame: ...

    def __iter__(self) -> Iterator[Frame]: ...
