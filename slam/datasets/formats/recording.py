"""Datasets of any format: raw images that are rectified when they are read.

The reader of a format finds camera streams and ground truth (`RawRecording`); `build_dataset` synchronises two cameras,
rectifies and interpolates the ground truth (`RectifiedDataset`). Place recognition needs the images of one camera only,
calibrated (`LeftImages`) or not (`UncalibratedImages`).
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from odometry.camera import StereoCamera
from slam.datasets.dataset import Frame, read_color
from slam.datasets.depth_units import Depth
from slam.datasets.formats.depth_images import DEPTH_UNUSED, DepthImages, DepthStream, match_depth
from slam.datasets.formats.ground_truth import GroundTruthTrajectory, read_pose_file
from slam.datasets.formats.image_sequence import ImageSequence
from slam.datasets.formats.timestamped_lists import ListFormat, read_image_list
from slam.datasets.rectification import ImageMap, Rectification, Size
from slam.datasets.time_sync import MAX_PAIR_OFFSET_S, associate_timestamps, interpolate_poses
from slam.errors import DataError

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

LEFT_ALONE = "the left camera alone is used"  # end of the remark that says why a pair is not used

MIN_SIDE_PX = 8  # in smaller images there is nothing to follow or to recognise


class Images(Protocol):
    """The raw images of one camera in the order of their exposure."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> Image:
        """Read image (H, W) uint8, grey. Raises DataError where it cannot be read."""
        ...

    def where(self, index: int) -> str:
        """File of an image and its position in the file, for error messages."""
        ...


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

    @property
    def remarks(self) -> tuple[str, ...]:
        """Notes for the user about what was left out and assumed on opening."""
        ...

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> Image: ...


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

    def read_color(self, index: int) -> Image | None:
        """Read a selected image (H, W, 3), RGB; None if it is grey."""
        return read_color(self.images, int(self.indices[index]))

    def where(self, index: int) -> str:
        """File of a selected image, for error messages."""
        return self.images.where(int(self.indices[index]))


@dataclass(frozen=True)
class CameraStream:
    """The raw images of one camera with their times.

    Attributes:
        images: N images.
        timestamps: (N,) seconds, increasing.
        remarks: notes for the user about the times.
    """

    images: Images
    timestamps: Array
    remarks: tuple[str, ...] = ()

    def subset(self, indices: NDArray[np.int64]) -> "CameraStream":
        """Return the images of some indices (K,), increasing."""
        if len(indices) == len(self.timestamps):
            return self
        return replace(self, images=ImageSubset(self.images, indices), timestamps=self.timestamps[indices])


def read_stream(path: Path, folder: Path, list_format: ListFormat) -> CameraStream:
    """Read a camera whose file names and times are in a list (see `read_image_list`).

    Raises:
        DataError: the list is damaged, or an image is missing.
    """
    images = read_image_list(path, folder, list_format)
    assert images.timestamps is not None
    return CameraStream(images, images.timestamps, images.remarks)


def read_ground_truth(path: Path, left: CameraStream) -> GroundTruthTrajectory:
    """Read poses of the left camera from a TUM file (with times) or a KITTI file (one pose for each image).

    A damaged file, or a KITTI file with another number of poses, gives no poses and a remark.

    Raises:
        DataError: the file is missing.
    """
    return read_pose_file(path, left.timestamps)


@dataclass(frozen=True)
class RawRecording:
    """What the reader of a format finds, before synchronisation and rectification.

    Attributes:
        name: short name for titles.
        left: stream of the left camera, or of the only camera.
        right: stream of the right camera, or None.
        depth: stream of depth images that are registered to the left ones, or None.
        ground_truth: measured poses, or None.
        remarks: notes for the user.
    """

    name: str
    left: CameraStream
    right: CameraStream | None = None
    depth: DepthStream | None = None
    ground_truth: GroundTruthTrajectory | None = None
    remarks: tuple[str, ...] = ()


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
        depth: N raw depth images, or None in a dataset without depth.
        remarks: notes about images that were left out and assumptions that were made on opening.
    """

    name: str
    timestamps: Array
    ground_truth: Array | None
    left: Images
    right: Images | None
    rectification: Rectification
    depth: DepthImages | None = None
    remarks: tuple[str, ...] = ()

    @property
    def camera(self) -> StereoCamera:
        """Intrinsics and baseline of the rectified pair."""
        return self.rectification.camera

    @property
    def has_right(self) -> bool:
        """Whether there is a right image for each left image."""
        return self.right is not None

    @property
    def has_depth(self) -> bool:
        """Whether there is a depth image for each left image."""
        return self.depth is not None

    def left_alone(self) -> "RectifiedDataset":
        """Return the same dataset with the left images alone."""
        return replace(self, right=None, depth=None)

    def __len__(self) -> int:
        return len(self.timestamps)

    def __getitem__(self, index: int) -> Frame:
        """Read one frame.

        Raises:
            IndexError: there is no such frame.
            DataError: an image cannot be read, or has another size than the first.
        """
        left = self.read_left(index)
        right = None if self.right is None else self._read(self.right, index, self.rectification.right)
        depth = None if self.depth is None else self._read_depth(self.depth, index)
        return Frame(index, float(self.timestamps[index]), left, right, depth=depth)

    def __iter__(self) -> Iterator[Frame]:
        return (self[index] for index in range(len(self)))

    def read_left(self, index: int) -> Image:
        """Read the left image (H, W) of a frame alone; errors as for the frame."""
        if not 0 <= index < len(self):
            raise IndexError(f"expected a frame from 0 to {len(self) - 1}, got {index}")
        return self._read(self.left, index, self.rectification.left)

    def read_color(self, index: int) -> Image | None:
        """Read the left image of a frame in colour: (H, W, 3), RGB, rectified; None where there is only grey."""
        colour = read_color(self.left, index)
        if colour is None or colour.shape[:2] != (self.camera.height, self.camera.width):
            return None
        return self.rectification.left(colour)

    def _read(self, images: Images, index: int, rectify: ImageMap) -> Image:
        image = images[index]
        self._check_shape(image.shape, images.where(index))
        return rectify(image)

    def _read_depth(self, images: DepthImages, index: int) -> Depth:
        depth = images[index]
        self._check_shape(depth.shape, images.where(index))
        return self.rectification.rectify_depth(depth)

    def _check_shape(self, shape: tuple[int, ...], where: str) -> None:
        expected = (self.camera.height, self.camera.width)
        if shape != expected:
            raise DataError(
                f"{where}: expected {expected[1]} x {expected[0]} pixels as in {self.left.where(0)},"
                f" found {shape[1]} x {shape[0]}; copy it again"
            )


@dataclass(frozen=True)
class LeftImages:
    """The rectified images of the left camera of a dataset (an ImageDataset).

    Attributes:
        dataset: a dataset without right and depth images: decoding them would only take time.
    """

    dataset: RectifiedDataset

    @classmethod
    def of(cls, dataset: RectifiedDataset) -> "LeftImages":
        """Return the left images of a dataset with one camera or two."""
        return cls(dataset.left_alone())

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

    @property
    def remarks(self) -> tuple[str, ...]:
        """Notes about what was left out and assumed on opening."""
        return self.dataset.remarks

    def __len__(self) -> int:
        return len(self.dataset)

    def __getitem__(self, index: int) -> Image:
        """Read image (H, W) uint8, grey."""
        return self.dataset.read_left(index)

    def read_color(self, index: int) -> Image | None:
        """Read image (H, W, 3), RGB; None where there is only grey."""
        return self.dataset.read_color(index)


@dataclass(frozen=True)
class UncalibratedImages:
    """The images of a camera without calibration, as they were recorded (an ImageDataset).

    Attributes:
        name: short name for titles.
        images: N images.
        timestamps: (N,) seconds, increasing, or None.
        ground_truth: T_world_camera (N, 4, 4), metres, or None.
        remarks: notes about what was left out and assumed on opening.
    """

    name: str
    images: Images
    timestamps: Array | None
    ground_truth: Array | None = None
    remarks: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.images)

    def __getitem__(self, index: int) -> Image:
        """Read image (H, W) uint8, grey."""
        return self.images[index]

    def read_color(self, index: int) -> Image | None:
        """Read image (H, W, 3), RGB; None where there is only grey."""
        return read_color(self.images, index)


def build_dataset(recording: RawRecording, rectify: Callable[[Size], Rectification]) -> RectifiedDataset:
    """Synchronise a recording, rectify its images and interpolate its ground truth.

    Args:
        recording: streams and poses as they were recorded.
        rectify: computes the rectification for an image size (width, height).

    Raises:
        DataError: no two images were taken at the same time, or the first image cannot be read or is too small.
    """
    recording = _synchronize(recording)
    size = read_size(recording.left.images)
    recording, rectification = _match_depth(recording, size), rectify(size)
    if recording.depth is not None:
        rectification = rectification.of_depth_camera()
    recording, poses = _interpolate_ground_truth(recording, rectification)
    return RectifiedDataset(
        name=recording.name,
        timestamps=recording.left.timestamps,
        ground_truth=poses,
        left=recording.left.images,
        right=None if recording.right is None else recording.right.images,
        rectification=rectification,
        depth=None if recording.depth is None else recording.depth.images,
        remarks=recording.remarks,
    )


def read_size(images: Images) -> Size:
    """Width and height of the images of a camera, by the first one.

    Raises:
        DataError: it cannot be read, or is too small.
    """
    height, width = images[0].shape
    check_size(images.where(0), (width, height))
    return width, height


def check_size(where: str, size: Size) -> None:
    """Raise DataError if images of a size (width, height) are too small; `where` is a file for the message."""
    if min(size) < MIN_SIDE_PX:
        raise DataError(
            f"{where}: images too small, expected at least {MIN_SIDE_PX} x {MIN_SIDE_PX} pixels, found"
            f" {size[0]} x {size[1]}; record or export larger ones"
        )


def rectify_left(
    pair: Callable[[Size], Rectification], alone: Callable[[Size], Rectification]
) -> Callable[[Size], Rectification]:
    """Return the rectification of a pair for its left camera; that of the left camera alone if the pair has none.

    The left images are then those of a run with both cameras, and no fault of the right one stops them.
    """

    def rectify(size: Size) -> Rectification:
        try:
            return pair(size)
        except DataError:
            return alone(size)

    return rectify


def _synchronize(recording: RawRecording) -> RawRecording:
    """Keep the images that have a partner in the other camera."""
    left, right = recording.left, recording.right
    recording = replace(recording, remarks=(*recording.remarks, *left.remarks))
    if right is None:
        return recording
    recording = replace(recording, remarks=(*recording.remarks, *right.remarks))
    left, right = _with_scale_of_both(left, right), _with_scale_of_both(right, left)
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


def _match_depth(recording: RawRecording, size: Size) -> RawRecording:
    """Keep the images that have a depth image, unless the depth cannot be used; beside a pair it is not needed."""
    if recording.depth is None:
        return recording
    if recording.right is not None:
        remark = f"there is a pair of cameras and depth: {DEPTH_UNUSED}"
        return replace(recording, depth=None, remarks=(*recording.remarks, remark))
    matched = match_depth(recording.depth, recording.left.timestamps, size)
    return replace(
        recording,
        left=recording.left.subset(matched.colour_indices),
        depth=matched.depth,
        remarks=(*recording.remarks, *matched.remarks),
    )


def _with_scale_of_both(stream: CameraStream, partner: CameraStream) -> CameraStream:
    """Return a stream of a pair whose images of 16 bits have the same scale in both cameras."""
    all_of = partner.images.images if isinstance(partner.images, ImageSubset) else partner.images
    if isinstance(stream.images, ImageSubset):
        inner = _with_scale_of_both(replace(stream, images=stream.images.images), partner)
        return replace(stream, images=replace(stream.images, images=inner.images))
    if not isinstance(stream.images, ImageSequence) or not isinstance(all_of, ImageSequence):
        return stream
    return replace(stream, images=replace(stream.images, partner_files=all_of.files))


def _interpolate_ground_truth(
    recording: RawRecording, rectification: Rectification
) -> tuple[RawRecording, Array | None]:
    """Keep the images that have ground truth, and return their poses (N, 4, 4) of the rectified left camera."""
    truth, left, right, depth = recording.ground_truth, recording.left, recording.right, recording.depth
    if truth is None:
        return recording, None
    if not len(truth.poses):
        return replace(recording, remarks=(*recording.remarks, *truth.remarks)), None
    trajectory = interpolate_poses(left.timestamps, truth.timestamps, truth.poses @ rectification.T_camera_view)
    kept = np.arange(len(left.timestamps))[trajectory.frames]
    remarks = (*recording.remarks, *truth.remarks, *([trajectory.remark] if trajectory.remark else []))
    right = None if right is None else right.subset(kept)
    depth = None if depth is None else depth.subset(kept)
    return replace(recording, left=left.subset(kept), right=right, depth=depth, remarks=remarks), trajectory.poses
