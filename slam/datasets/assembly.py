"""What every layout ends in: images and times of one camera or two, and poses, become a drive."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.datasets.camera_drive import CameraDrive, Images, Picked
from slam.datasets.moments import SYNCHRONOUS, pair_times, way_at
from slam.datasets.rectification import Rectification, Size
from slam.datasets.stamped import Table, check_increasing, read_image_list
from slam.errors import DataError
from slam.storage.trajectory import read_trajectory

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Eye:
    """What one camera has recorded.

    Attributes:
        images: N of them.
        times: (N,) seconds, increasing.
    """

    images: Images
    times: Array

    def only(self, indices: NDArray[np.int64]) -> "Eye":
        """Some of the images."""
        return self if len(indices) == len(self.times) else Eye(Picked(self.images, indices), self.times[indices])


def read_eye(path: Path, folder: Path, table: Table) -> Eye:
    """A camera whose images and times stand in a table (see `read_image_list`).

    Raises:
        DataError: the table is damaged, or an image is missing.
    """
    images = read_image_list(path, folder, table)
    assert images.timestamps is not None
    return Eye(images, images.timestamps)


@dataclass(frozen=True)
class TrueWay:
    """Poses that somebody has measured.

    Attributes:
        times: (M,) seconds, increasing.
        poses: T_world_camera (M, 4, 4), metres, of the left camera as it is.
    """

    times: Array
    poses: Array


def read_true_way(path: Path, left: Eye) -> TrueWay:
    """Poses of the left camera from a file, TUM with times, or KITTI with one for each image.

    Raises:
        DataError: the file is missing or damaged, or has another number of poses.
    """
    times, poses = read_trajectory(path)
    if times is None and len(poses) != len(left.times):
        raise DataError(
            f"{path}: expected {len(left.times)} poses, one for each image, or poses with times (TUM), found"
            f" {len(poses)}; export it again"
        )
    times = left.times if times is None else times
    check_increasing(path, times)
    return TrueWay(times, poses)


@dataclass(frozen=True)
class Recording:
    """All that a layout has to find.

    Attributes:
        name: for titles.
        left: camera.
        right: camera, or None.
        truth: or None.
        remarks: what was noticed.
    """

    name: str
    left: Eye
    right: Eye | None = None
    truth: TrueWay | None = None
    remarks: tuple[str, ...] = ()


def assemble(recording: Recording, rectify: Callable[[Size], Rectification]) -> CameraDrive:
    """Bring together what was recorded together.

    Args:
        recording: what there is.
        rectify: what becomes of images of a size.

    Raises:
        DataError: no pair of images was taken at the same time, or the first image cannot be read.
    """
    paired = _paired(recording)
    height, width = paired.left.images[0].shape
    rectification = rectify((width, height))
    paired, poses = _with_truth(paired, rectification)
    return CameraDrive(
        name=paired.name,
        timestamps=paired.left.times,
        ground_truth=poses,
        left=paired.left.images,
        right=None if paired.right is None else paired.right.images,
        rectification=rectification,
        remarks=paired.remarks,
    )


def _paired(recording: Recording) -> Recording:
    left, right = recording.left, recording.right
    if right is None:
        return recording
    pairs = pair_times(left.times, right.times)
    if not len(pairs):
        raise DataError(
            f"{right.images.where(0)}: expected right images within {SYNCHRONOUS:g} s of left ones, found none;"
            " are the two of the same recording?"
        )
    alone = len(left.times) + len(right.times) - 2 * len(pairs)
    remarks = (f"{alone} images without a partner in the other camera are left out",) if alone else ()
    return replace(
        recording,
        left=left.only(pairs[:, 0]),
        right=right.only(pairs[:, 1]),
        remarks=(*recording.remarks, *remarks),
    )


def _with_truth(recording: Recording, rectification: Rectification) -> tuple[Recording, Array | None]:
    truth = recording.truth
    if truth is None:
        return recording, None
    way = way_at(recording.left.times, truth.times, truth.poses @ rectification.T_camera_view)
    kept = np.arange(len(recording.left.times))[way.frames]
    right = None if recording.right is None else recording.right.only(kept)
    remarks = (way.remark,) if way.remark else ()
    left = recording.left.only(kept)
    return replace(recording, left=left, right=right, remarks=(*recording.remarks, *remarks)), way.poses
