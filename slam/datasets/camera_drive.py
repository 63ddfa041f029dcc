"""A dataset of any format: raw images that are rectified when they are read."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from odometry.camera import StereoCamera
from slam.datasets.dataset import Frame
from slam.datasets.rectification import ImageMap, Rectification
from slam.errors import DataError

Array = NDArray[np.float64]
Image = NDArray[np.uint8]


class Images(Protocol):
    """The raw images of one camera in the order of their exposure."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> Image:
        """Read image (H, W) uint8, grey. Raises DataError where it cannot be read."""
        ...

    def where(self, index: int) -> str:
        """File of an image and its position in the file, for error messages."""
        ...


@dataclass(frozen=True)
class RectifiedDataset:
    """A dataset (see `slam.datasets.dataset.Dataset`) whose images are read and rectified on demand.

    Attributes:
        name: short name for titles.
        timestamps: (N,) seconds, increasing.
        ground_truth: T_world_camera (N, 4, 4), metres, of the rectified left camera; world is its first pose.
            None where it is unknown.
        left: N raw images.
        right: N raw images, or None in a dataset with one camera.
        rectification: map from the raw to the rectified images.
        remarks: notes about images that were left out and assumptions that were made on opening.
    """

    name: str
    timestamps: Array
    ground_truth: Array | None
    left: Images
    right: Images | None
    rectification: Rectification
    remarks: tuple[str, ...] = ()

    @property
    def camera(self) -> StereoCamera:
        """Intrinsics and baseline of the rectified pair."""
        return self.rectification.camera

    @property
    def has_right(self) -> bool:
        """Whether there is a right image for each left image."""
        return self.right is not None

    def without_right(self) -> "RectifiedDataset":
        """Return the same dataset with the left camera alone."""
        return replace(self, right=None)

    def __len__(self) -> int:
        return len(self.timestamps)

    def __getitem__(self, index: int) -> Frame:
        """Read one frame.

        Raises:
            IndexError: there is no such frame.
            DataError: an image cannot be read, or has another size than the first.
        """
        if not 0 <= index < len(self):
            raise IndexError(f"expected a frame from 0 to {len(self) - 1}, got {index}")
        left = self._read(self.left, index, self.rectification.left)
        right = None if self.right is None else self._read(self.right, index, self.rectification.right)
        return Frame(index, float(self.timestamps[index]), left, right)

    def __iter__(self) -> Iterator[Frame]:
        return (self[index] for index in range(len(self)))

    def _read(self, images: Images, index: int, rectify: ImageMap) -> Image:
        image = images[index]
        expected = (self.camera.height, self.camera.width)
        if image.shape != expected:
            raise DataError(
                f"{images.where(index)}: expected {expected[1]} x {expected[0]} pixels as in {self.left.where(0)},"
                f" found {image.shape[1]} x {image.shape[0]}; copy it again"
            )
        return rectify(image)


@dataclass(frozen=True)
class ImageSubset:
    """A selection of the images of a camera.

    Attributes:
        images: all images.
        indices: (N,) of the selected images.
    """

    images: Images
    indices: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.indices)

    def __getitem__(self, index: int) -> Image:
        """Read a selected image (H, W) uint8, grey."""
        return self.images[int(self.indices[index])]

    def where(self, index: int) -> str:
        """File of a selected image, for error messages."""
        return self.images.where(int(self.indices[index]))
