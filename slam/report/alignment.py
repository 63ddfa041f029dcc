"""Laying an estimated trajectory over the ground truth, to draw both and to see the error at each frame."""

import numpy as np
from numpy.typing import NDArray

from odometry.se3 import inverse
from slam.evaluation.trajectory import Similarity, umeyama
from slam.record import RunRecord

Array = NDArray[np.float64]

_STRAIGHT = 1e-2  # below this ratio of second to first spread a track does not say how it is rolled
_LEVER = 1e-2  # of the first spread


def anchored_truth(record: RunRecord) -> Array | None:
    """Ground truth (N, 4, 4), metres, moved to start at the odometry's first pose; None where unknown.

    In this frame (first camera) the plan view is x-z whatever frame the ground truth was recorded in.
    """
    if record.ground_truth is None or not len(record.ground_truth):
        return None
    return np.asarray(record.odometry[0] @ inverse(record.ground_truth[0]) @ record.ground_truth)


def fit(estimate: Array, truth: Array, with_scale: bool = False) -> Similarity:
    """Return what takes an estimate (N, 4, 4) onto the truth (N, 4, 4) with least squared distance.

    The positions of a straight or standing track leave its roll open, and a map drawn with any roll would be
    upside down: there the cameras' orientations have a say, as points a little to all sides of each camera.
    """
    p, q = estimate[:, :3, 3], truth[:, :3, 3]
    best = umeyama(p, q, "sim3" if with_scale else "se3")
    if min(_roundness(p), _roundness(q)) >= _STRAIGHT:
        return best
    lever = max(_LEVER * float(np.linalg.norm(q - q.mean(axis=0), axis=1).mean()), 1e-3)
    R = umeyama(_around(estimate, lever / best.scale), _around(truth, lever)).R
    return Similarity(R, q.mean(axis=0) - best.scale * R @ p.mean(axis=0), best.scale)


def _around(poses: Array, lever: float) -> Array:
    sides = lever * np.concatenate([np.eye(3), -np.eye(3)])
    return np.concatenate([poses[:, :3, 3] + poses[:, :3, :3] @ side for side in sides])


def _roundness(positions: Array) -> float:
    """Second over first singular value of positions (N, 3) about their mean: 0 for a line or a point."""
    spread = np.linalg.svd(positions - positions.mean(axis=0), compute_uv=False)
    return float(spread[1] / spread[0]) if len(spread) > 1 and spread[0] > 0 else 0.0


def position_error(estimate: Array, truth: Array, with_scale: bool = False) -> Array:
    """Distance (N,), metres, of each aligned position of an estimate (N, 4, 4) from the truth (N, 4, 4)."""
    aligned = fit(estimate, truth, with_scale).apply(estimate[:, :3, 3])
    return np.asarray(np.linalg.norm(aligned - truth[:, :3, 3], axis=1))
