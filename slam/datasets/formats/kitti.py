"""Datasets in the layout of the KITTI odometry benchmark (Geiger et al., CVPR 2012)."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.camera import StereoCamera
from slam.datasets.dataset import Frame
from slam.datasets.formats.ground_truth import read_one_pose_per_image
from slam.datasets.formats.image_sequence import (
    ImageSequence,
    open_image_folder,
    read_or_count_times,
    read_times,
)
from slam.datasets.formats.kitti_files import (
    StereoFiles,
    find_images,
    find_poses,
    find_sequence,
    is_kitti,
    read_calibration_lines,
)
from slam.datasets.formats.recording import read_size
from slam.datasets.rectification import NOMINAL_BASELINE_M
from slam.errors import DataError

Array = NDArray[np.float64]

# A dataset with one camera gets a virtual right camera: monocular odometry reports depths as disparities of that pair.
_VIRTUAL_BASELINE = np.array([[0.0, 0.0, 0.0, NOMINAL_BASELINE_M], [0.0] * 4, [0.0] * 4])

_MAX_PROJECTION = 1e7  # px, and px times metres: a larger number in a projection matrix is damage, not a camera
# Relative difference of the intrinsics of a pair. Disparity is depth only where they are equal; 0.1 % is rounding.
_MAX_INTRINSICS_DIFFERENCE = 1e-3


@dataclass(frozen=True)
class KittiDataset:
    """A KITTI sequence (see `slam.datasets.dataset.Dataset`) whose images are read on demand.

    Attributes:
        name: name of the sequence, such as "00".
        camera: intrinsics and baseline of the pair in `files`.
        timestamps: (N,) seconds, increasing.
        ground_truth: T_world_camera (N, 4, 4), metres, of the left camera of `files`; world is its first
            pose, whatever the origin of the file. None where there is no file.
        files: paths of the images.
        remarks: notes about times and ground truth.
    """

    name: str
    camera: StereoCamera
    timestamps: Array
    ground_truth: Array | None
    files: StereoFiles
    remarks: tuple[str, ...] = ()

    @property
    def has_right(self) -> bool:
        """Whether there is a right image for each left image."""
        return self.files.right is not None

    @property
    def has_depth(self) -> bool:
        """Whether there is a depth image for each left image: never in this layout."""
        return False

    def __len__(self) -> int:
        return len(self.files.left)

    def __getitem__(self, index: int) -> Frame:
        """Read one frame.

        Raises:
            IndexError: there is no such frame.
            DataError: an image cannot be read, or has another size than the first.
        """
        left, right_images = self.read_left(index), self._images[1]
        right = None if right_images is None else self._image(right_images, index)
        return Frame(index, float(self.timestamps[index]), left, right)

    def __iter__(self) -> Iterator[Frame]:
        return (self[index] for index in range(len(self)))

    def read_left(self, index: int) -> NDArray[np.uint8]:
        """Read the left image (H, W) of a frame alone; errors as for the frame."""
        if not 0 <= index < len(self):
            raise IndexError(f"expected a frame from 0 to {len(self) - 1}, got {index}")
        return self._image(self._images[0], index)

    def read_color(self, index: int) -> NDArray[np.uint8] | None:
        """Read the left image of a frame in colour: (H, W, 3), RGB; None where there is only grey."""
        return self._images[0].read_color(index)

    @cached_property
    def _images(self) -> tuple[ImageSequence, ImageSequence | None]:
        """Images of both cameras; those of 16 bits have one scale."""
        left, right = self.files.left, self.files.right
        if right is None:
            return ImageSequence(self.name, left, None), None
        first = ImageSequence(self.name, left, None, partner_files=right)
        return first, ImageSequence(self.name, right, None, partner_files=left)

    def _image(self, images: ImageSequence, index: int) -> NDArray[np.uint8]:
        image = images[index]
        expected = (self.camera.height, self.camera.width)
        if image.shape != expected:
            raise DataError(
                f"{images.where(index)}: expected {expected[1]} x {expected[0]} pixels as in {self.files.left[0]},"
                f" found {image.shape[1]} x {image.shape[0]}; copy the image again"
            )
        return image


def open_kitti(root: Path, sequence: str | None = None, left_only: bool = False) -> KittiDataset:
    """Open a sequence and check all files but the images themselves.

    Args:
        root: folder in KITTI odometry layout, or the folder of one sequence.
        sequence: name of the sequence ("00"); None where there is only one.
        left_only: whether right images and their calibration are not looked at.

    Raises:
        DataError: a file is missing, damaged or inconsistent with the others.
    """
    folder = find_sequence(root, sequence)
    files = find_images(folder, left_only)
    name, path = folder.absolute().name, folder / "calib.txt"
    P_left, P_right = read_projections(path, [f"P{camera}" for camera in files.cameras], files.right is not None)
    size = read_size(ImageSequence(name, files.left, None))
    timestamps, time_remarks = read_times(folder / "times.txt", len(files.left))
    ground_truth, truth_remarks = _read_ground_truth(folder, files, P_left)
    camera = stereo_camera(P_left, P_right, size)
    return KittiDataset(name, camera, timestamps, ground_truth, files, (*time_remarks, *truth_remarks))


def open_image_sequence(source: Path, sequence: str | None = None, fps: float | None = None) -> ImageSequence:
    """Open a folder of images, or the left images of a KITTI sequence: here they need no calibration and no right ones.

    Args:
        source: folder in KITTI odometry layout, or of images in the natural order of their names.
        sequence: name of the KITTI sequence; None where there is only one.
        fps: images per second, where there is no `times.txt`; None if no timestamps are needed.

    Raises:
        DataError: there are no images, their times do not fit them, or `fps` is not a frame rate.
    """
    if not is_kitti(source):
        return open_image_folder(source, fps)
    folder = find_sequence(source, sequence)
    files = find_images(folder, left_only=True).left
    times, remarks = read_or_count_times(folder / "times.txt", len(files), fps)
    poses = find_poses(folder)
    truth, truth_remarks = (None, ()) if poses is None else read_one_pose_per_image(poses, len(files))
    return ImageSequence(folder.absolute().name, files, times, truth, (*remarks, *truth_remarks))


def read_projections(path: Path, names: Sequence[str], is_pair: bool) -> tuple[Array, Array]:
    """Read the projection matrices (3, 4) of the left and the right camera of a rectified pair.

    Args:
        path: calibration file.
        names: of the two lines, the left camera's first.
        is_pair: whether the right camera is used; if not, its line may be missing or wrong.

    Raises:
        DataError: the file is missing, or does not describe a rectified pair.
    """
    lines = read_calibration_lines(path)
    P_left = _projection(path, names[0], lines)
    try:
        P_right = _projection(path, names[1], lines)
        _check_pair(path, names, P_left, P_right)
    except DataError:
        if is_pair:
            raise
        P_right = P_left - _VIRTUAL_BASELINE * P_left[0, 0]
    return P_left, P_right


def _check_pair(path: Path, names: Sequence[str], P_left: Array, P_right: Array) -> None:
    if not np.allclose(P_left[:, :3], P_right[:, :3], rtol=_MAX_INTRINSICS_DIFFERENCE):
        raise DataError(f"{path}: expected the same intrinsics in {names[0]} and {names[1]}; rectify the images")
    if P_left[0, 3] <= P_right[0, 3]:
        raise DataError(
            f"{path}: expected {names[1]} to the right of {names[0]} (4th number smaller), found"
            f" {P_right[0, 3]:g} and {P_left[0, 3]:g}; swap the cameras or correct the sign"
        )


def _projection(path: Path, name: str, lines: dict[str, Array]) -> Array:
    if name not in lines:
        raise DataError(f"{path}: expected a line '{name}: 12 numbers', found none; copy the calibration again")
    numbers = lines[name]
    if len(numbers) != 12:
        raise DataError(f"{path}: expected 12 numbers in {name}, found {len(numbers)}; copy the calibration again")
    P = numbers.reshape(3, 4)
    if not np.isfinite(P).all() or min(P[0, 0], P[1, 1]) <= 0:
        raise DataError(f"{path}: expected finite numbers and positive focal lengths in {name}; correct that line")
    if np.abs(P).max() > _MAX_PROJECTION or not np.allclose(P[2, :3], [0, 0, 1]):
        raise DataError(f"{path}: expected the projection of a rectified camera in {name}; correct that line")
    return P


def stereo_camera(P_left: Array, P_right: Array, size: tuple[int, int]) -> StereoCamera:
    """Return the camera of a pair of projection matrices (3, 4) and an image size (width, height)."""
    fx = float(P_left[0, 0])
    return StereoCamera(
        fx=fx,
        fy=float(P_left[1, 1]),
        cx=float(P_left[0, 2]),
        cy=float(P_left[1, 2]),
        baseline=float(P_left[0, 3] - P_right[0, 3]) / fx,
        width=size[0],
        height=size[1],
    )


def _read_ground_truth(folder: Path, files: StereoFiles, P_left: Array) -> tuple[Array | None, tuple[str, ...]]:
    path = find_poses(folder)
    if path is None:
        return None, ()
    T_file_camera0, remarks = read_one_pose_per_image(path, len(files.left))
    if T_file_camera0 is None:
        return None, remarks
    # P_left = K [I | t] takes points of camera 0, so the left camera of the pair is at -K^-1 (K t) in camera 0's frame.
    T_camera0_left = se3.pose(np.eye(3), -np.linalg.solve(P_left[:, :3], P_left[:, 3]).astype(float))
    T_file_left = T_file_camera0 @ T_camera0_left
    return se3.inverse(T_file_left[0]) @ T_file_left, remarks
