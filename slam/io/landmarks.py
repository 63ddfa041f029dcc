"""`landmarks.npz`: the frame that observed each point of a run's maps, and the camera.

Arrays: `frames`, (M,) int32, one for each of the M points of map_before.ply and map_after.ply, in their order;
`intrinsics`, (4,), fx, fy, cx, cy, pixels; `size`, (2,), width and height, pixels.

`covariances.npz`: covariance of each pose of a run.

Arrays `odometry` and `corrected`, (N, 6, 6) float64: covariance of the right perturbation `T_world_camera @ exp(xi)` of
each pose in the trajectory file of that name, in the camera frame, rotation before translation (rad, m), with the first
pose held fixed. The covariance of a position in the world is `R @ C[3:, 3:] @ R.T`, with R of the pose.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from odometry.camera import PinholeCamera
from place_recognition.evaluation.ground_truth_files import read_array
from slam.errors import DataError
from slam.io.files import atomic_writer
from slam.run_result import RunRecord


def write_covariances(path: Path, record: RunRecord) -> None:
    """Write covariances.npz; an estimate without covariances is left out.

    Raises:
        OutputError: the file cannot be written.
    """
    known = {"odometry": record.odometry_covariances, "corrected": record.corrected_covariances}
    with atomic_writer(path, "wb") as file:
        np.savez_compressed(file, **{name: rows for name, rows in known.items() if rows is not None})  # type: ignore[arg-type]


_REMEDY = "make the run again with: revisit run SOURCE --out DIR"


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
        DataError: missing or damaged.
    """
    try:
        arrays = [read_array(path, name) for name in ("frames", "intrinsics", "size")]
    except ValueError as error:
        raise DataError(f"{path}: expected the observers of a run's landmarks, found {error}; {_REMEDY}") from None
    kinds = [None if array is None else (array.dtype.str, array.ndim) for array in arrays]
    frames, intrinsics, size = arrays
    if frames is None or intrinsics is None or size is None or kinds != [("<i4", 1), ("<f8", 1), ("<i4", 1)]:
        raise DataError(f"{path}: expected the arrays frames, intrinsics and size, found others; {_REMEDY}")
    if intrinsics.shape != (4,) or size.shape != (2,) or not _is_camera(intrinsics, size) or (frames < 0).any():
        raise DataError(f"{path}: expected a camera, and frames from 0 on, found others; {_REMEDY}")
    return LandmarkObservers(frames, intrinsics, size)


def _is_camera(intrinsics: NDArray[np.float64], size: NDArray[np.int32]) -> bool:
    return bool(np.isfinite(intrinsics).all() and (intrinsics[:2] > 0).all() and (size > 0).all())
