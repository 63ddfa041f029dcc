"""Measured poses of a recording. They are optional: what cannot be used is left out with a remark, never an error."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from slam.datasets.formats.timestamped_lists import SPACE_SEPARATED_SECONDS, ListFormat, read_timestamped_rows
from slam.datasets.time_sync import short_name
from slam.errors import DataError
from slam.io.files import read_lines
from slam.io.trajectory_files import check_positions, read_kitti

Array = NDArray[np.float64]

_MIN_QUATERNION_NORM = 1e-6  # shorter ones have no direction: trackers write zeros when they have lost the target

_COUNTED_STEP_S = (0.5, 2.0)  # of images that are as far apart as poses with the times 1, 2, 3, ...


@dataclass(frozen=True)
class GroundTruthTrajectory:
    """Measured poses of the left camera, at times of their own.

    Attributes:
        timestamps: (M,) seconds, increasing; empty where the poses cannot be used.
        poses: T_world_camera (M, 4, 4), metres, of the unrectified left camera.
        remarks: what was left out, and why.
    """

    timestamps: Array
    poses: Array
    remarks: tuple[str, ...] = ()


def unusable_ground_truth(reason: str) -> GroundTruthTrajectory:
    """Return a trajectory without poses, with the reason as its remark."""
    return GroundTruthTrajectory(np.empty(0), np.empty((0, 4, 4)), (f"{reason}; the ground truth is not used",))


def read_pose_file(path: Path, image_times: Array) -> GroundTruthTrajectory:
    """Read poses of the left camera from a TUM file (with times) or a KITTI file (one pose for each image).

    Args:
        path: file of the poses.
        image_times: (N,) seconds, of all images.

    Raises:
        DataError: the file is missing.
    """
    if not path.is_file():
        raise DataError(f"{path}: expected this file, found none; check the path or copy it there")
    return _read_or_remark(lambda: _read(path, image_times))


def read_timed_poses(path: Path, list_format: ListFormat, quaternion: Sequence[int]) -> GroundTruthTrajectory:
    """Read a list of time, position and quaternion.

    Args:
        path: file of the poses.
        list_format: its syntax.
        quaternion: columns of x, y, z and w, from 0.
    """
    return _read_or_remark(lambda: _read_timed(path, list_format, quaternion))


def read_one_pose_per_image(path: Path, count: int) -> tuple[Array | None, tuple[str, ...]]:
    """Read T_world_camera (N, 4, 4) from a KITTI file that must have one pose for each of `count` images.

    Returns:
        The poses, or None; and the remark why there are none.
    """
    truth = _read_or_remark(lambda: _read_kitti(path, np.arange(float(count))))
    return (truth.poses if len(truth.poses) else None), truth.remarks


def _read_or_remark(read: Callable[[], GroundTruthTrajectory]) -> GroundTruthTrajectory:
    try:
        return read()
    except DataError as error:
        return unusable_ground_truth(str(error))


def _read(path: Path, image_times: Array) -> GroundTruthTrajectory:
    lines = [line.strip() for line in read_lines(path)]
    words = next((line.split() for line in lines if re.match(r"[-+.\d]", line)), [])
    if len(words) == 12:
        return _read_kitti(path, image_times)
    if len(words) == 8:
        truth = _read_timed(path, SPACE_SEPARATED_SECONDS, (4, 5, 6, 7))
        _check_not_counted(path, truth.timestamps, image_times)
        return truth
    raise DataError(
        f"{path}: expected KITTI poses (12 numbers a line) or TUM (8), found {len(words)}; export one of them"
    )


def _check_not_counted(path: Path, times: Array, image_times: Array) -> None:
    """Raise DataError if times count the poses, as in ICL-NUIM, beside images that are not a second apart."""
    if len(times) < 3 or len(image_times) < 2 or (np.diff(times) != 1.0).any():
        return
    step = float(np.median(np.diff(image_times)))
    if not _COUNTED_STEP_S[0] < step < _COUNTED_STEP_S[1]:
        raise DataError(
            f"{path}: expected a time in seconds in each line, found 1, 2, 3, ... for images {step:.3g} s apart; write"
            " the times of the images there"
        )


def _read_kitti(path: Path, image_times: Array) -> GroundTruthTrajectory:
    return _one_per_image(path, read_kitti(path), image_times)


def _one_per_image(path: Path, poses: Array, image_times: Array) -> GroundTruthTrajectory:
    if len(poses) != len(image_times):
        raise DataError(
            f"{path}: expected {len(image_times)} poses, one for each image, or poses with times (TUM), found"
            f" {len(poses)}; copy the file that belongs to this recording"
        )
    return GroundTruthTrajectory(image_times, poses)


def _read_timed(path: Path, list_format: ListFormat, quaternion: Sequence[int]) -> GroundTruthTrajectory:
    rows = read_timestamped_rows(path, list_format, 8)
    values, remarks = rows.values, rows.remarks
    with np.errstate(over="ignore"):  # of lengths that are left out
        lengths = np.linalg.norm(values[:, 4:], axis=1)
    good = (lengths >= _MIN_QUATERNION_NORM) & np.isfinite(lengths)
    if not good.any():
        raise DataError(f"{path}: expected unit quaternions in columns 5 to 8, found others; copy the file again")
    if not good.all():
        at = values[np.argmin(good), 0]
        remarks += (
            f"{short_name(path)}: {np.sum(~good)} poses without a rotation are left out, the first at {at:.6f} s",
        )
    values = values[good]
    check_positions(path, values[:, 1:4])
    poses = np.repeat(np.eye(4)[None], len(values), axis=0)
    poses[:, :3, :3] = Rotation.from_quat(values[:, list(quaternion)]).as_matrix()
    poses[:, :3, 3] = values[:, 1:4]
    return GroundTruthTrajectory(values[:, 0], poses, remarks)
