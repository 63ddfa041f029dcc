"""Time synchronisation: pairs of left and right images, and poses interpolated at the times of images."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from odometry import se3

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

MAX_PAIR_OFFSET_S = 0.005  # between the images of a pair: at 20 m/s a car drives 10 cm in that time
MAX_GAP_S = 0.5  # between measured poses: across a longer gap, interpolation is no ground truth


def associate_timestamps(left: Array, right: Array, max_offset_s: float = MAX_PAIR_OFFSET_S) -> Indices:
    """Pair the left and right images that were taken together: indices (K, 2), both columns increasing.

    Two images are a pair if each is nearest in time to the other.

    Args:
        left: (N,) seconds, increasing.
        right: (M,) seconds, increasing.
        max_offset_s: largest difference in time within a pair.
    """
    if not len(left) or not len(right):
        return np.empty((0, 2), np.int64)
    nearest = _nearest(right, left)
    mutual = _nearest(left, right)[nearest] == np.arange(len(left))
    together = mutual & (np.abs(right[nearest] - left) <= max_offset_s)
    return np.stack([np.flatnonzero(together), nearest[together]], axis=1)


def _nearest(times: Array, queries: Array) -> Indices:
    """Index of the time nearest to each query; of two equally near ones, the earlier."""
    after = np.clip(np.searchsorted(times, queries), 1, max(len(times) - 1, 1))
    after = np.minimum(after, len(times) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(queries - times[before] <= times[after] - queries, before, after)


@dataclass(frozen=True)
class InterpolatedTrajectory:
    """Ground-truth poses at the times of images.

    Attributes:
        frames: range of the images that have a pose: those between the first and the last measured pose.
        poses: T_world_camera (N, 4, 4) of these images, metres; world is the first pose. None where unknown.
        remark: which images were left out, or why the poses are unknown; empty otherwise.
    """

    frames: slice
    poses: Array | None
    remark: str = ""


def interpolate_poses(times: Array, pose_times: Array, poses: Array) -> InterpolatedTrajectory:
    """Interpolate measured poses at the times of images: positions linearly, rotations by slerp.

    Images before the first and after the last measured pose are left out, so that every image has ground truth.
    If the measurement paused for longer than MAX_GAP_S while images were taken, no poses are returned.

    Args:
        times: (N,) of the images, seconds, increasing.
        pose_times: (M,) of the measured poses, seconds, increasing.
        poses: measured T_world_camera (M, 4, 4), metres.
    """
    everything = slice(0, len(times))
    first, last = np.searchsorted(times, pose_times[0]), np.searchsorted(times, pose_times[-1], side="right")
    if last - first < 2 or len(pose_times) < 2:
        return InterpolatedTrajectory(everything, None, "the ground truth is of another time and not used")
    frames = slice(int(first), int(last))
    gaps = (np.diff(pose_times) > MAX_GAP_S) & (pose_times[:-1] < times[last - 1]) & (pose_times[1:] > times[first])
    if gaps.any():
        at_s, length_s = float(pose_times[:-1][gaps][0] - times[0]), float(np.diff(pose_times)[gaps][0])
        remark = f"the ground truth pauses for {length_s:.1f} s after {at_s:.1f} s and is not used"
        return InterpolatedTrajectory(everything, None, remark)
    T_world_camera = _interpolate(times[frames], pose_times, poses)
    left_out = len(times) - (frames.stop - frames.start)
    remark = f"{left_out} images before or after the ground truth are left out" if left_out else ""
    return InterpolatedTrajectory(frames, se3.inverse(T_world_camera[0]) @ T_world_camera, remark)


def _interpolate(times: Array, pose_times: Array, poses: Array) -> Array:
    out = np.repeat(np.eye(4)[None], len(times), axis=0)
    out[:, :3, :3] = Slerp(pose_times, Rotation.from_matrix(poses[:, :3, :3]))(times).as_matrix()
    out[:, :3, 3] = np.stack([np.interp(times, pose_times, axis) for axis in poses[:, :3, 3].T], axis=1)
    return out
