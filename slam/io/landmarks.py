"""`landmarks.npz`: the frame that observed each point of a run's maps, and the camera.

Arrays: `frames`, (M,) int32, one for each of the M points of map_before.ply and map_after.ply, in their order;
`intrinsics`, (4,), fx, fy, cx, cy, pixels; `size`, (2,), width and height, pixels.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from odometry.camera import PinholeCamera
from place_recognition.evaluation.ground_truth_files import read_array
from slam.errors import DataError
from slam.io.files import atomic_writer

_REMEDY = "make the run again with: revisit run SOURCE --out DIR"
# Name, data type and number of dimensions of each array.
_ARRAYS = {"frames": ("<i4", 1), "intrinsics": ("<f8", 1), "size": ("<i4", 1)}


@dataclass(frozen=True)
class LandmarkObservers:
    """The frame that observed each landmark, and the camera.

    Attributes:
        frames: index of the frame, (M,).
        intrinsics: fx, fy, cx, cy, (4,), pixels; (0, 0) is the centre of the first pixel.
        size: width and height, (2,), pixels.
    """

    frames: NDArray[np.int32]
    intrinsics: NDArray[np.float64]
    size: NDArray[np.int32]


def write_landmark_observers(path: Path, frames: NDArray[np.int32], camera: PinholeCamera) -> None:
    """Write landmarks.npz.

    Raises:
        OutputError: the file cannot be written.
    """
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float64)
    size = np.array([camera.width, camera.height], np.int32)
    with atomic_writer(path, "wb") as file:
        np.savez_compressed(file, frames=frames, intrinsics=intrinsics, size=size)


def read_landmark_observers(path: Path) -> LandmarkObservers:
    """Read landmarks.npz.

    Raises:
        DataError: the file is missing or damaged.
    """
    try:
        arrays = {name: read_array(path, name) for name in _ARRAYS}
    except ValueError as error:
        raise DataError(f"{path}: expected the observers of a run's landmarks, found {error}; {_REMEDY}") from None
    found = {name: array for name, array in arrays.items() if array is not None}
    if {name: (array.dtype.str, array.ndim) for name, array in found.items()} != _ARRAYS:
        raise DataError(f"{path}: expected the arrays {', '.join(_ARRAYS)}, found others; {_REMEDY}")
    observers = LandmarkObservers(**found)
    if not _is_camera(observers.intrinsics, observers.size) or (observers.frames < 0).any():
        raise DataError(f"{path}: expected a camera, and frames from 0 on, found others; {_REMEDY}")
    return observers


def _is_camera(intrinsics: NDArray[np.float64], size: NDArray[np.int32]) -> bool:
    if intrinsics.shape != (4,) or size.shape != (2,):
        return False
    return bool(np.isfinite(intrinsics).all() and (intrinsics[:2] > 0).all() and (size > 0).all())
