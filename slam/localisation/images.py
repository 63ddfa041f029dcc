"""The images to be localized: one, a folder, a video, or the left images of a dataset."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from odometry.camera import StereoCamera
from slam.datasets.images import IMAGE_SUFFIXES, ImageSequence
from slam.datasets.left_images import ImageDataset, LeftImages
from slam.datasets.open import open_images
from slam.datasets.source import DatasetSpec
from slam.errors import DataError

Image = NDArray[np.uint8]

_CAMERA_TOLERANCE = 0.01  # share of the image's width by which two calibrations of one camera may differ


@dataclass(frozen=True)
class Queries:
    """Images of the camera of a map.

    Attributes:
        images: the images; their order is not used.
        camera: camera of the map.
    """

    images: ImageDataset
    camera: StereoCamera

    def __len__(self) -> int:
        return len(self.images)

    def __iter__(self) -> Iterator[tuple[str, Image]]:
        """Name and content of each image.

        Raises:
            DataError: one cannot be read, or has another size than those of the map.
        """
        for index in range(len(self)):
            name, image = self._name(index), self.images[index]
            if image.shape != (self.camera.height, self.camera.width):
                size = f"{self.camera.width} x {self.camera.height}"
                raise DataError(
                    f"{self._where(index)}: expected {size} pixels as in the map, found {image.shape[1]} x"
                    f" {image.shape[0]}; give images of the camera that made the map"
                )
            yield name, image

    def _name(self, index: int) -> str:
        return self.images.files[index].name if isinstance(self.images, ImageSequence) else self._where(index)

    def _where(self, index: int) -> str:
        return self.images.where(index) if isinstance(self.images, ImageSequence) else f"{self.images.name}:{index}"


def open_queries(source: DatasetSpec, camera: StereoCamera) -> Queries:
    """Open images that the camera of a map has taken.

    Raises:
        DataError: there are none, or they are said to come from another camera.
    """
    if source.path.is_file() and source.path.suffix.lower() in IMAGE_SUFFIXES:
        return Queries(ImageSequence(source.path.stem, (source.path,), None), camera)
    images = open_images(source)
    if isinstance(images, LeftImages):
        _compare(source.path, images.dataset.camera, camera)
    return Queries(images, camera)


def _compare(path: Path, found: StereoCamera, expected: StereoCamera) -> None:
    numbers = [np.array([camera.fx, camera.fy, camera.cx, camera.cy]) for camera in (found, expected)]
    if np.abs(numbers[0] - numbers[1]).max() > _CAMERA_TOLERANCE * expected.width:
        shown = [", ".join(f"{value:.1f}" for value in each) for each in numbers]
        raise DataError(
            f"{path}: expected the camera of the map, fx, fy, cx, cy = {shown[1]}, found {shown[0]};"
            " give images of the camera that made the map"
        )
