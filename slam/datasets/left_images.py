"""Datasets of single images for place recognition: the left camera of any recording, calibrated or not."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from slam.datasets.camera_drive import Images, RectifiedDataset

Array = NDArray[np.float64]
Image = NDArray[np.uint8]


class ImageDataset(Protocol):
    """The images of one camera in the order of their exposure."""

    @property
    def name(self) -> str:
        """Short name for titles."""
        ...

    @property
    def timestamps(self) -> Array | None:
        """(N,) seconds, increasing; None where the times are unknown."""
        ...

    @property
    def ground_truth(self) -> Array | None:
        """T_world_camera (N, 4, 4), metres, or None where it is unknown."""
        ...

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> Image: ...


@dataclass(frozen=True)
class LeftImages:
    """The rectified images of the left camera of a dataset (an ImageDataset).

    Attributes:
        dataset: a dataset without right images, which would only cost time to decode.
    """

    dataset: RectifiedDataset

    @classmethod
    def of(cls, dataset: RectifiedDataset) -> "LeftImages":
        """Return the left images of a dataset with one camera or two."""
        return cls(dataset.without_right())

    @property
    def name(self) -> str:
        """Name of the dataset."""
        return self.dataset.name

    @property
    def timestamps(self) -> Array:
        """(N,) seconds, increasing."""
        return self.dataset.timestamps

    @property
    def ground_truth(self) -> Array | None:
        """T_world_camera (N, 4, 4), metres, or None."""
        return self.dataset.ground_truth

    def __len__(self) -> int:
        return len(self.dataset)

    def __getitem__(self, index: int) -> Image:
        """Read image (H, W) uint8, grey."""
        return self.dataset[index].left


@dataclass(frozen=True)
class UncalibratedImages:
    """The images of a camera without calibration, as they were recorded (an ImageDataset).

    Attributes:
        name: short name for titles.
        images: N images.
        timestamps: (N,) seconds, increasing, or None.
        ground_truth: T_world_camera (N, 4, 4), metres, or None.
    """

    name: str
    images: Images
    timestamps: Array | None
    ground_truth: Array | None = None

    def __len__(self) -> int:
        return len(self.images)

    def __getitem__(self, index: int) -> Image:
        """Read image (H, W) uint8, grey."""
        return self.images[index]
