"""A drive of any layout: images as they were taken, turned into those of an ideal camera or pair on reading."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from odometry.camera import StereoCamera
from slam.datasets.dataset import Frame
from slam.datasets.rectification import Rectification, View
from slam.errors import DataError

Array = NDArray[np.float64]
Image = NDArray[np.uint8]


class Images(Protocol):
    """Images of one camera, in the order in which they were taken."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> Image:
        """Read image (H, W) uint8, grey. Raises DataError where it cannot be read."""
        ...

    def where(self, index: int) -> str:
        """File of an image, and its place in it, for messages."""
        ...


@dataclass(frozen=True)
class CameraDrive:
    """A recorded drive (see `slam.datasets.dataset.Dataset`): images are read when asked for.

    Attributes:
        name: for titles.
        timestamps: (N,) seconds, increasing.
        ground_truth: T_world_camera (N, 4, 4), metres, of the ideal left camera; world is its first position.
            None where it is not known.
        left: N images.
        right: N images, or None in a drive with one camera.
        rectification: what becomes of them.
        remarks: what was left out, or taken for granted, when the drive was opened.
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
        """Intrinsics and baseline of the ideal pair."""
        return self.rectification.camera

    @property
    def has_right(self) -> bool:
        """Whether there is a right image for each left one."""
        return self.right is not None

    def with_left_alone(self) -> "CameraDrive":
        """The same drive with one camera."""
        return replace(self, right=None)

    def __len__(self) -> int:
        return len(self.timestamps)

    def __getitem__(self, index: int) -> Frame:
        """Read one frame.

        Raises:
            IndexError: no such frame.
            DataError: an image that cannot be read or has another size than the first.
        """
        if not 0 <= index < len(self):
            raise IndexError(f"expected a frame from 0 to {len(self) - 1}, got {index}")
        left = self._view(self.left, index, self.rectification.left)
        right = None if self.right is None else self._view(self.right, index, self.rectification.right)
        return Frame(index, float(self.timestamps[index]), left, right)

    def __iter__(self) -> Iterator[Frame]:
        return (self[index] for index in range(len(self)))

    def _view(self, images: Images, index: int, view: View) -> Image:
        image = images[index]
        expected = (self.camera.height, self.camera.width)
        if image.shape != expected:
            raise DataError(
                f"{images.where(index)}: expected {expected[1]} x {expected[0]} pixels as in {self.left.where(0)},"
                f" found {image.shape[1]} x {image.shape[0]}; copy it again"
            )
        return view(image)


@dataclass(frozen=True)
class Picked:
    """Some of the images of a camera, in an order of their own.

    Attributes:
        images: all of them.
        indices: (N,) of those that count.
    """

    images: Images
    indices: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.indices)

    def __getitem__(self, index: int) -> Image:
        """Read one of those that count."""
        return self.images[int(self.indices[index])]

    def where(self, index: int) -> str:
        """Its file."""
        return self.images.where(int(self.indices[index]))
