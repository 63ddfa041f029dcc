"""Laying an estimated trajectory over the ground truth, to draw both and to see the error at each frame."""

import warnings

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from odometry.se3 import inverse
from slam.record import DriveRecord

Array = NDArray[np.float64]

_STRAIGHT = 1e-2  # below this ratio of second to first spread a track does not say how it is rolled


def anchored_truth(record: DriveRecord) -> Array | None:
    """Ground truth (N, 4, 4), metres, moved to start at the odometry's first pose; None where unknown.

    In this frame (first camera) the plan view is x-z whatever frame the ground truth was recorded in.
    """
    if record.ground_truth is None or not len(record.ground_truth):
        return None
    return np.asarray(record.odometry[0] @ inverse(record.ground_truth[0]) @ record.ground_truth)


def similarity(estimate: Array, truth: Array, with_scale: bool = False) -> Array:
    """Transform (4, 4) that takes an estimate (N, 4, 4) onto the truth (N, 4, 4) with least squared distance.

    Its upper left block is a rotation, times the scale when with_scale. SciPy solves for the rotation
    (Wahba's problem). A straight or standing track leaves it open: the first poses then decide.
    """
    p, q = estimate[:, :3, 3], truth[:, :3, 3]
    centre_p, centre_q = p.mean(axis=0), q.mean(axis=0)
    R = _rotation(estimate, truth)
    moved = (p - centre_p) @ R.T
    spread = float((moved**2).sum())
    scale = float(((q - centre_q) * moved).sum()) / spread if with_scale and spread > 0 else 1.0
    T = np.eye(4)
    T[:3, :3] = scale * R
    T[:3, 3] = centre_q - scale * R @ centre_p
    return T


def _rotation(estimate: Array, truth: Array) -> Array:
    p, q = (T[:, :3, 3] - T[:, :3, 3].mean(axis=0) for T in (estimate, truth))
    if min(_roundness(p), _roundness(q)) < _STRAIGHT:
        return np.asarray(truth[0, :3, :3] @ estimate[0, :3, :3].T)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # SciPy's on poor conditioning, which is handled above
        return np.asarray(Rotation.align_vectors(q, p)[0].as_matrix())


def _roundness(centred: Array) -> float:
    """Second over first singular value of centred positions (N, 3): 0 for a line or a point."""
    spread = np.linalg.svd(centred, compute_uv=False)
    return float(spread[1] / spread[0]) if len(spread) > 1 and spread[0] > 0 else 0.0


def position_error(estimate: Array, truth: Array, with_scale: bool = False) -> Array:
    """Distance (N,), metres, of each aligned position of an estimate (N, 4, 4) from the truth (N, 4, 4)."""
    T = similarity(estimate, truth, with_scale)
    p = estimate[:, :3, 3] @ T[:3, :3].T + T[:3, 3]
    return np.asarray(np.linalg.norm(p - truth[:, :3, 3], axis=1))
