"""Trajectory files of runs in the formats of KITTI and TUM, and the covariances of their poses.

Both hold T_world_camera, metres, one line for each frame. KITTI: the upper three rows of the matrix, row by row. TUM:
`timestamp tx ty tz qx qy qz qw`. Numbers have as many digits as are needed to read the same double again. Files of
other programs are read by `trajectory_reader`.

`covariances.npz` has the arrays `odometry` and `corrected`, (N, 6, 6) float64: covariance of the right perturbation
`T_world_camera @ exp(xi)` of each pose in the trajectory file of that name, in the camera frame, rotation before
translation (rad, m), with the first pose held fixed. The covariance of a position in the world is
`R @ C[3:, 3:] @ R.T`, with R of the pose.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from slam.errors import DataError
from slam.io.files import atomic_writer, read_numbers
from slam.run_result import RunRecord

Array = NDArray[np.float64]

MAX_POSITION_M = 1e12  # farther than the sun: no position on earth
MAX_ROTATION_ERROR = 1e-2  # largest element of R R^T - 1; files rounded to three digits are accepted


def write_kitti(path: Path, poses: Array) -> None:
    """Write T_world_camera (N, 4, 4), metres, as KITTI poses.

    Raises:
        OutputError: the file cannot be written.
    """
    _write_rows(path, poses[:, :3, :].reshape(-1, 12))


def read_kitti(path: Path) -> Array:
    """Read T_world_camera (N, 4, 4), metres, from KITTI poses, exactly as in the file.

    Raises:
        DataError: the file is missing, a line does not have 12 finite numbers, or a matrix is not a rotation.
    """
    return kitti_poses(path, read_numbers(path, 12))


def kitti_poses(path: Path, numbers: Array) -> Array:
    """Return T_world_camera (N, 4, 4) of KITTI's numbers (N, 12).

    Raises:
        DataError: a matrix is not a rotation, or a position is impossibly far away.
    """
    rows = numbers.reshape(-1, 3, 4)
    poses = np.repeat(np.eye(4)[None], len(rows), axis=0)
    poses[:, :3] = rows
    _check_rotations(path, poses[:, :3, :3])
    check_positions(path, rows[:, :, 3])
    return poses


def write_tum(path: Path, timestamps: Array, poses: Array) -> None:
    """Write T_world_camera (N, 4, 4), metres, at timestamps (N,), seconds, as TUM.

    Raises:
        OutputError: the file cannot be written.
    """
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    _write_rows(path, np.column_stack([timestamps, poses[:, :3, 3], quaternions]))


def read_tum(path: Path) -> tuple[Array, Array]:
    """Read timestamps (N,), seconds, and T_world_camera (N, 4, 4), metres, from a TUM file.

    Quaternions are normalised.

    Raises:
        DataError: the file is missing, a line does not have 8 finite numbers, or a quaternion has length zero.
    """
    rows = read_numbers(path, 8)
    return rows[:, 0], tum_poses(path, rows[:, 1:])


def tum_poses(path: Path, numbers: Array) -> Array:
    """Return T_world_camera (N, 4, 4) of positions and quaternions (N, 7): x y z qx qy qz qw.

    Raises:
        DataError: a quaternion has length zero, or a position is impossibly far away.
    """
    with np.errstate(over="ignore"):  # of lengths that are refused below
        lengths = np.linalg.norm(numbers[:, 3:], axis=1)
    wrong = (lengths < 1e-6) | ~np.isfinite(lengths)
    if wrong.any():
        at = int(np.argmax(wrong))
        raise DataError(
            f"{path}, pose {at}: expected a unit quaternion, found one of length {lengths[at]:g}; write the file again"
        )
    check_positions(path, numbers[:, :3])
    poses = np.repeat(np.eye(4)[None], len(numbers), axis=0)
    poses[:, :3, :3] = Rotation.from_quat(numbers[:, 3:]).as_matrix()
    poses[:, :3, 3] = numbers[:, :3]
    return poses


def check_positions(path: Path, positions: Array) -> None:
    """Raise DataError if positions (N, 3), metres, are impossibly far away."""
    far = np.abs(positions).max(axis=1) > MAX_POSITION_M
    if far.any():
        at = int(np.argmax(far))
        raise DataError(f"{path}, pose {at}: expected a position in metres, found {positions[at]}; correct that line")


def write_covariances(path: Path, record: RunRecord) -> None:
    """Write covariances.npz; an estimate without covariances is left out.

    Raises:
        OutputError: the file cannot be written.
    """
    known = {"odometry": record.odometry_covariances, "corrected": record.corrected_covariances}
    with atomic_writer(path, "wb") as file:
        np.savez_compressed(file, **{name: rows for name, rows in known.items() if rows is not None})  # type: ignore[arg-type]


def _write_rows(path: Path, rows: Array) -> None:
    with atomic_writer(path) as file:
        # repr is the shortest text of the same double; evo refuses a blank at the end of a line
        file.writelines(" ".join(map(repr, row)) + "\n" for row in rows.tolist())


def _check_rotations(path: Path, rotations: Array) -> None:
    errors = np.abs(rotations @ rotations.swapaxes(1, 2) - np.eye(3)).max(axis=(1, 2))
    wrong = (errors > MAX_ROTATION_ERROR) | (np.linalg.det(rotations) < 0)
    if wrong.any():
        at = int(np.argmax(wrong))
        raise DataError(
            f"{path}, pose {at}: expected a rotation matrix, found one that is off by {errors[at]:.3g}"
            " or mirrored; are these KITTI poses?"
        )
