"""Pairs of estimated and true poses: by time where both have times, else pose by pose.

A true pose is interpolated at the time of an estimated one, as the readers of recordings do: between two true poses at
most `MAX_GAP_S` apart. Elsewhere an estimated pose takes the true pose within `MAX_TIME_DIFFERENCE_S`, and else it has
none. The motion between two true poses is one of constant twist, so a constant delay of one of the clocks costs no ATE.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.datasets.time_sync import MAX_GAP_S
from slam.io.trajectory_reader import Trajectory
from slam.pose_graph.optimization.planar_or_spatial import SE3, inverse

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

MAX_TIME_DIFFERENCE_S = 0.01  # between two poses that are compared without interpolation


@dataclass(frozen=True)
class PosePairs:
    """Estimated poses that have a true one.

    Attributes:
        estimate: (N, 4, 4) estimated poses, metres.
        truth: (N, 4, 4) true poses at the same times, metres.
        rows: (N,) rows of the estimated poses in their trajectory, increasing.
    """

    estimate: Array
    truth: Array
    rows: Rows


def pair_by_time(estimate: Trajectory, truth: Trajectory) -> PosePairs:
    """Pair poses of two trajectories that both have times."""
    assert estimate.times is not None
    assert truth.times is not None
    times, true_times = estimate.times, truth.times
    between = _rows_between(times, true_times)
    near, true_rows = _rows_near(times, true_times)
    alone = ~np.isin(near, between)
    rows = np.concatenate([between, near[alone]])
    poses = np.concatenate([_interpolate(times[between], true_times, truth.poses), truth.poses[true_rows[alone]]])
    order = np.argsort(rows)
    return PosePairs(estimate.poses[rows[order]], poses[order], rows[order])


def _rows_between(times: Array, true_times: Array) -> Rows:
    """Return the rows of times (N,) that lie between two true ones that are close enough for interpolation."""
    if len(true_times) < 2:
        return np.zeros(0, np.int64)
    before = np.clip(np.searchsorted(true_times, times, side="right") - 1, 0, len(true_times) - 2)
    is_inside = (times >= true_times[0]) & (times <= true_times[-1])
    return np.flatnonzero(is_inside & (np.diff(true_times)[before] <= MAX_GAP_S))


def _interpolate(times: Array, true_times: Array, poses: Array) -> Array:
    """Return true poses (N, 4, 4) at times (N,) between the first and the last of at least two true ones."""
    if not len(times):
        return np.zeros((0, 4, 4))
    before = np.clip(np.searchsorted(true_times, times, side="right") - 1, 0, len(true_times) - 2)
    share = (times - true_times[before]) / (true_times[before + 1] - true_times[before])
    twist = SE3().log(inverse(poses[before]) @ poses[before + 1])
    return np.asarray(poses[before] @ SE3().exp(share[:, None] * twist))


def _rows_near(times: Array, true_times: Array) -> tuple[Rows, Rows]:
    """Return rows of times (N,) and of the true times within the bound; each true one serves its nearest time alone."""
    after = np.clip(np.searchsorted(true_times, times), 1, max(len(true_times) - 1, 1))
    candidates = np.clip(np.stack([after - 1, after]), 0, len(true_times) - 1)
    differences = np.abs(true_times[candidates] - times)
    nearest, difference = candidates[differences.argmin(axis=0), np.arange(len(times))], differences.min(axis=0)
    by_difference = np.argsort(difference, kind="stable")
    _, first = np.unique(nearest[by_difference], return_index=True)
    rows = np.sort(by_difference[first])
    rows = rows[difference[rows] <= MAX_TIME_DIFFERENCE_S]
    return rows, nearest[rows]
