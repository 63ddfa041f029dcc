"""Times that belong together: left with right images, images with poses that were measured at other moments."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from odometry import se3

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

SYNCHRONOUS = 0.005  # s between the two images of a pair, at most: a car drives 10 cm in that time
LARGEST_GAP = 0.5  # s between measured poses, at most, for those between them to be known


def pair_times(left: Array, right: Array, apart: float = SYNCHRONOUS) -> Indices:
    """Which left and right images were taken together: indices (K, 2), both increasing.

    Args:
        left: (N,) seconds, increasing.
        right: (M,) likewise.
        apart: seconds that two images of a pair may be apart.
    """
    if not len(left) or not len(right):
        return np.empty((0, 2), np.int64)
    nearest = _nearest(right, left)
    mutual = _nearest(left, right)[nearest] == np.arange(len(left))
    together = mutual & (np.abs(right[nearest] - left) <= apart)
    return np.stack([np.flatnonzero(together), nearest[together]], axis=1)


def _nearest(times: Array, wanted: Array) -> Indices:
    after = np.clip(np.searchsorted(times, wanted), 1, max(len(times) - 1, 1))
    after = np.minimum(after, len(times) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(wanted - times[before] <= times[after] - wanted, before, after)


@dataclass(frozen=True)
class KnownWay:
    """Poses at the moments of images.

    Attributes:
        frames: which images they are of: those between the first and the last measured pose.
        poses: T_world_camera (N, 4, 4) of these, metres; world is the first of them. None where they are not known.
        remark: what was left out, or why nothing is known; empty if neither.
    """

    frames: slice
    poses: Array | None
    remark: str = ""


def way_at(times: Array, measured: Array, poses: Array) -> KnownWay:
    """Poses at moments between those at which they were measured: straight ahead, and turning evenly.

    Images before and after all measured poses are left out, so that each has its truth. Where the measurement
    paused for longer than LARGEST_GAP while images were taken, nothing is known.

    Args:
        times: (N,) of images, seconds, increasing.
        measured: (M,) seconds, increasing.
        poses: T_world_camera (M, 4, 4), metres, at these.
    """
    everything = slice(0, len(times))
    first, last = np.searchsorted(times, measured[0]), np.searchsorted(times, measured[-1], side="right")
    if last - first < 2 or len(measured) < 2:
        return KnownWay(everything, None, "the ground truth is of another time and not used")
    frames = slice(int(first), int(last))
    gaps = (np.diff(measured) > LARGEST_GAP) & (measured[:-1] < times[last - 1]) & (measured[1:] > times[first])
    if gaps.any():
        at, length = float(measured[:-1][gaps][0] - times[0]), float(np.diff(measured)[gaps][0])
        return KnownWay(
            everything, None, f"the ground truth pauses for {length:.1f} s after {at:.1f} s and is not used"
        )
    T_world_camera = _between(times[frames], measured, poses)
    left_out = len(times) - (frames.stop - frames.start)
    remark = f"{left_out} images before or after the ground truth are left out" if left_out else ""
    return KnownWay(frames, se3.inverse(T_world_camera[0]) @ T_world_camera, remark)


def _between(times: Array, measured: Array, poses: Array) -> Array:
    out = np.repeat(np.eye(4)[None], len(times), axis=0)
    out[:, :3, :3] = Slerp(measured, Rotation.from_matrix(poses[:, :3, :3]))(times).as_matrix()
    out[:, :3, 3] = np.stack([np.interp(times, measured, axis) for axis in poses[:, :3, 3].T], axis=1)
    return out
