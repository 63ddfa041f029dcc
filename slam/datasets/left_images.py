"""Images alone, for place recognition: of any drive the left camera's, in whatever layout it was recorded."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from slam.datasets.camera_drive import CameraDrive, Images

Array = NDArray[np.float64]
Image = NDArray[np.uint8]


class ImageRecording(Protocol):
    """Images of one camera in the order in which they were taken."""

    @property
    def name(self) -> str:
        """For titles."""
        ...

    @property
    def timestamps(self) -> Array | None:
        """(N,) seconds, increasing; None where nothing says when they were taken."""
        ...

    @property
    def ground_truth(self) -> Array | None:
        """T_world_camera (N, 4, 4), metres, or None where it is not known."""
        ...

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> Image: ...


@dataclass(frozen=True)
class LeftImages:
    """The ideal left camera's images of a drive (an ImageRecording)."""

    drive: CameraDrive

    @property
    def name(self) -> str:
        """Of the drive."""
        return self.drive.name

    @property
    def timestamps(self) -> Array:
        """(N,) seconds, increasing."""
        return self.drive.timestamps

    @property
    def ground_truth(self) -> Array | None:
        """T_world_camera (N, 4, 4), metres, or None."""
        return self.drive.ground_truth

    def __len__(self) -> int:
        return len(self.drive)

    def __getitem__(self, index: int) -> Image:
        """Read image (H, W) uint8, grey."""
        return self.drive[index].left


def left_images(drive: CameraDrive) -> LeftImages:
    """Of a drive with one camera or two."""
    return LeftImages(drive.with_left_alone())


@dataclass(frozen=True)
class RawImages:
    """Images of a camera of which nothing is known (an ImageRecording)."""

    name: str
    images: Images
    timestamps: Array | None
    ground_truth: Array | None = None

    def __len__(self) -> int:
        return len(self.images)

    def __getitem__(self, index: int) -> Image:
        """Read image (H, W) uint8, grey."""
        return self.images[index]
