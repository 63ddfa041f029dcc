"""Builds a dataset from what a format's reader has found: streams of one or two cameras, and ground truth."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.datasets.camera_drive import Images, ImageSubset, RectifiedDataset
from slam.datasets.moments import MAX_PAIR_OFFSET_S, associate_timestamps, interpolate_poses
from slam.datasets.rectification import Rectification, Size
from slam.datasets.stamped import ListFormat, check_increasing, read_image_list
from slam.errors import DataError
from slam.storage.trajectory import read_trajectory

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CameraStream:
    """The raw images of one camera with their times.

    Attributes:
        images: N images.
        timestamps: (N,) seconds, increasing.
    """

    images: Images
    timestamps: Array

    def subset(self, indices: NDArray[np.int64]) -> "CameraStream":
        """Return the images of some indices (K,), increasing."""
        if len(indices) == len(self.timestamps):
            return self
        return CameraStream(ImageSubset(self.images, indices), self.timestamps[indices])


def read_stream(path: Path, folder: Path, list_format: ListFormat) -> CameraStream:
    """Read a camera whose file names and times are in a list (see `read_image_list`).

    Raises:
        DataError: the list is damaged, or an image is missing.
    """
    images = read_image_list(path, folder, list_format)
    assert images.timestamps is not None
    return CameraStream(images, images.timestamps)


@dataclass(frozen=True)
class GroundTruthTrajectory:
    """Measured poses of the left camera, at times of their own.

    Attributes:
        timestamps: (M,) seconds, increasing.
        poses: T_world_camera (M, 4, 4), metres, of the unrectified left camera.
    """

    timestamps: Array
    poses: Array


def read_ground_truth(path: Path, left: CameraStream) -> GroundTruthTrajectory:
    """Read poses of the left camera from a TUM file (with times) or a KITTI file (one pose for each image).

    Raises:
        DataError: the file is missing or damaged, or a KITTI file has another number of poses.
    """
    times, poses = read_trajectory(path)
    if times is None and len(poses) != len(left.timestamps):
        raise DataError(
            f"{path}: expected {len(left.timestamps)} poses, one for each image, or poses with times (TUM), found"
            f" {len(poses)}; export it again"
        )
    times = left.timestamps if times is None else times
    check_increasing(path, times)
    return GroundTruthTrajectory(times, poses)


@dataclass(frozen=True)
class RawRecording:
    """What the reader of a format finds, before synchronisation and rectification.

    Attributes:
        name: short name for titles.
        left: stream of the left camera, or of the only camera.
        right: stream of the right camera, or None.
        ground_truth: measured poses, or None.
        remarks: notes for the user.
    """

    name: str
    left: CameraStream
    right: CameraStream | None = None
    ground_truth: GroundTruthTrajectory | None = None
    remarks: tuple[str, ...] = ()


def build_dataset(recording: RawRecording, rectify: Callable[[Size], Rectification]) -> RectifiedDataset:
    """Synchronise a recording, rectify its images and interpolate its ground truth.

    Args:
        recording: streams and poses as they were recorded.
        rectify: computes the rectification for an image size (width, height).

    Raises:
        DataError: no two images were taken at the same time, or the first image cannot be read.
    """
    recording = _synchronize(recording)
    height, width = recording.left.images[0].shape
    rectification = rectify((width, height))
    recording, poses = _interpolate_ground_truth(recording, rectification)
    return RectifiedDataset(
        name=recording.name,
        timestamps=recording.left.timestamps,
        ground_truth=poses,
        left=recording.left.images,
        right=None if recording.right is None else recording.right.images,
        rectification=rectification,
        remarks=recording.remarks,
    )


def _synchronize(recording: RawRecording) -> RawRecording:
    """Keep the images that have a partner in the other camera."""
    left, right = recording.left, recording.right
    if right is None:
        return recording
    pairs = associate_timestamps(left.timestamps, right.timestamps)
    if not len(pairs):
        raise DataError(
            f"{right.images.where(0)}: expected right images within {MAX_PAIR_OFFSET_S:g} s of left ones, found none;"
            " are the two of the same recording?"
        )
    alone = len(left.timestamps) + len(right.timestamps) - 2 * len(pairs)
    remarks = (f"{alone} images without a partner in the other camera are left out",) if alone else ()
    return replace(
        recording,
        left=left.subset(pairs[:, 0]),
        right=right.subset(pairs[:, 1]),
        remarks=(*recording.remarks, *remarks),
    )


def _interpolate_ground_truth(
    recording: RawRecording, rectification: Rectification
) -> tuple[RawRecording, Array | None]:
    """Keep the images that have ground truth, and return their poses (N, 4, 4) of the rectified left camera."""
    truth, left, right = recording.ground_truth, recording.left, recording.right
    if truth is None:
        return recording, None
    trajectory = interpolate_poses(left.timestamps, truth.timestamps, truth.poses @ rectification.T_camera_view)
    kept = np.arange(len(left.timestamps))[trajectory.frames]
    remarks = (*recording.remarks, *([trajectory.remark] if trajectory.remark else []))
    right = None if right is None else right.subset(kept)
    return replace(recording, left=left.subset(kept), right=right, remarks=remarks), trajectory.poses
