"""Datasets in the layout of the KITTI odometry benchmark (Geiger et al., CVPR 2012).

pykitti parses the calibration file. Its `odometry` class is not used: it needs the laser's `Tr`, which is missing if
only the images were unpacked; it prints a message if ground truth is missing; and it rounds times to microseconds.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.camera import StereoCamera
from slam.datasets.dataset import Frame
from slam.datasets.formats.image_sequence import read_grey, read_times
from slam.datasets.formats.kitti_files import StereoFiles, find_images, find_poses, find_sequence
from slam.datasets.rectification import NOMINAL_BASELINE_M
from slam.errors import DataError
from slam.io.trajectory_files import read_kitti

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
    """

    name: str
    camera: StereoCamera
    timestamps: Array
    ground_truth: Array | None
    files: StereoFiles

    @property
    def has_right(self) -> bool:
        """Whether there is a right image for each left image."""
        return self.files.right is not None

    @property
    def remarks(self) -> tuple[str, ...]:
        """Empty: no image of a KITTI sequence is left out."""
        return ()

    def __len__(self) -> int:
        return len(self.files.left)

    def __getitem__(self, index: int) -> Frame:
        """Read one frame.

        Raises:
            IndexError: there is no such frame.
            DataError: an image cannot be read, or has another size than the first.
        """
        if not 0 <= index < len(self):
            raise IndexError(f"expected a frame from 0 to {len(self) - 1}, got {index}")
        left = self._image(self.files.left[index])
        right = None if self.files.right is None else self._image(self.files.right[index])
        return Frame(index, float(self.timestamps[index]), left, right)

    def __iter__(self) -> Iterator[Frame]:
        return (self[index] for index in range(len(self)))

    def _image(self, path: Path) -> NDArray[np.uint8]:
        image = read_grey(path)
        expected = (self.camera.height, self.camera.width)
        if image.shape != expected:
            raise DataError(
                f"{path}: expected {expected[1]} x {expected[0]} pixels as in {self.files.left[0]},"
                f" found {image.shape[1]} x {image.shape[0]}; copy the image again"
            )
        return image


def open_kitti(root: Path, sequence: str | None = None) -> KittiDataset:
    """Open a sequence and check all files but the images themselves.

    Args:
        root: folder in KITTI odometry layout, or the folder of one sequence.
        sequence: name of the sequence ("00"); None where there is only one.

    Raises:
        DataError: a file is missing, damaged or inconsistent with the others.
    """
    folder = find_sequence(root, sequence)
    files = find_images(folder)
    P_left, P_right = _read_projections(folder / "calib.txt", files)
    height, width = read_grey(files.left[0]).shape
    return KittiDataset(
        name=folder.absolute().name,
        camera=_stereo_camera(P_left, P_right, (width, height)),
        timestamps=read_times(folder / "times.txt", len(files.left)),
        ground_truth=_read_ground_truth(folder, files, P_left),
        files=files,
    )


def _read_projections(path: Path, files: StereoFiles) -> tuple[Array, Array]:
    import pykitti.utils  # imported here because it imports pandas, which is slow

    try:
        lines = pykitti.utils.read_calib_file(str(path))
    except OSError as error:
        raise DataError(f"{path}: expected the calibration, found {error.strerror}; unpack it there") from None
    except ValueError:
        raise DataError(f"{path}: expected only lines such as 'P0: 12 numbers', found others; remove them") from None
    left, right = (f"P{camera}" for camera in files.cameras)
    P_left = _projection(path, left, lines)
    if files.right is None and right not in lines:
        return P_left, P_left - _VIRTUAL_BASELINE * P_left[0, 0]
    P_right = _projection(path, right, lines)
    _check_pair(path, files.cameras, P_left, P_right)
    return P_left, P_right


def _check_pair(path: Path, cameras: tuple[int, int], P_left: Array, P_right: Array) -> None:
    if not np.allclose(P_left[:, :3], P_right[:, :3], rtol=_MAX_INTRINSICS_DIFFERENCE):
        raise DataError(f"{path}: expected the same intrinsics in P{cameras[0]} and P{cameras[1]}; rectify the images")
    if P_left[0, 3] <= P_right[0, 3]:
        raise DataError(
            f"{path}: expected P{cameras[1]} to the right of P{cameras[0]} (4th number smaller), found"
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


def _stereo_camera(P_left: Array, P_right: Array, size: tuple[int, int]) -> StereoCamera:
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


def _read_ground_truth(folder: Path, files: StereoFiles, P_left: Array) -> Array | None:
    path = find_poses(folder)
    if path is None:
        return None
    T_file_camera0 = read_kitti(path)
    if len(T_file_camera0) != len(files.left):
        raise DataError(
            f"{path}: expected {len(files.left)} poses, one for each image, found {len(T_file_camera0)};"
            " copy the file that belongs to this sequence or remove it"
        )
    # P_left = K [I | t] takes points of camera 0, so the left camera of the pair is at -K^-1 (K t) in camera 0's frame.
    T_camera0_left = se3.pose(np.eye(3), -np.linalg.solve(P_left[:, :3], P_left[:, 3]).astype(float))
    T_file_left = T_file_camera0 @ T_camera0_left
    return se3.inverse(T_file_left[0]) @ T_file_left
