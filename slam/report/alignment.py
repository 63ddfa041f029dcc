"""Alignment of an estimated trajectory with the ground truth, and the position error of each frame."""

import numpy as np
from numpy.typing import NDArray

from odometry.se3 import inverse
from slam.evaluation.trajectory import Similarity, umeyama
from slam.record import RunRecord

Array = NDArray[np.float64]

_MIN_ROUNDNESS = 1e-2  # a path with a lower ratio of second to first spread does not determine its roll
_LEVER = 1e-2  # length of the levers, as a share of the mean distance from the centre


def anchor_ground_truth(record: RunRecord) -> Array | None:
    """Return the ground truth (N, 4, 4), metres, moved to start at the odometry's first pose; None without one.

    In this frame, that of the first camera, x and z span the plan view, whatever frame the ground truth came in.
    """
    if record.ground_truth is None or not len(record.ground_truth):
        return None
    return np.asarray(record.odometry[0] @ inverse(record.ground_truth[0]) @ record.ground_truth)


def align_trajectory(estimate: Array, truth: Array, with_scale: bool = False) -> Similarity:
    """Return the least-squares transform from an estimate (N, 4, 4) to the truth (N, 4, 4).

    The positions of a straight path do not determine its roll, and a map drawn with a wrong roll may be upside down.
    For such paths the orientations of the cameras are used too, as points at a small lever on all sides of a camera.
    """
    p, q = estimate[:, :3, 3], truth[:, :3, 3]
    best = umeyama(p, q, "sim3" if with_scale else "se3")
    if min(_roundness(p), _roundness(q)) >= _MIN_ROUNDNESS:
        return best
    lever = max(_LEVER * float(np.linalg.norm(q - q.mean(axis=0), axis=1).mean()), 1e-3)
    R = umeyama(_around(estimate, lever / best.scale), _around(truth, lever)).R
    return Similarity(R, q.mean(axis=0) - best.scale * R @ p.mean(axis=0), best.scale)


def _around(poses: Array, lever: float) -> Array:
    sides = lever * np.concatenate([np.eye(3), -np.eye(3)])
    return np.concatenate([poses[:, :3, 3] + poses[:, :3, :3] @ side for side in sides])


def _roundness(positions: Array) -> float:
    """Return the ratio of second to first singular value of centred positions (N, 3): 0 for a line or a point."""
    spread = np.linalg.svd(positions - positions.mean(axis=0), compute_uv=False)
    return float(spread[1] / spread[0]) if len(spread) > 1 and spread[0] > 0 else 0.0


def position_errors(estimate: Array, truth: Array, with_scale: bool = False) -> Array:
    """Return the distances (N,), metres, between an estimate (N, 4, 4) after alignment and the truth (N, 4, 4)."""
    aligned = align_trajectory(estimate, truth, with_scale).apply(estimate[:, :3, 3])
    return np.asarray(np.linalg.norm(aligned - truth[:, :3, 3], axis=1))
