"""Scale drift of one camera: the log scale of every frame, from loops that measure relative scale.

Scale multiplies along the path, so its logarithm adds up and the graph is linear. The loops are weighted robustly
(Geman and McClure). Scale is solved before the poses, so that the back ends work on rigid motions.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import spsolve

from slam.loop_closing import LoopClosure

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

_ITERATIONS = 20  # of reweighting
_KERNEL_CHI2 = 9.0  # chi-square of a loop at which its weight is a quarter: three sigmas
_MIN_STEP = 1e-3  # path length of a camera that stands still: its scale is held, not fixed


def estimate_log_scales(steps: Array, loops: Sequence[LoopClosure], drift: float) -> Array:
    """Logarithm (N,) of each frame's scale in that of the first frame.

    Args:
        steps: (N - 1,) path length from each frame to the next.
        loops: loops, with the relative scale of their frames where that was measured (sigma above 0).
        drift: standard deviation of the log scale's change over a path of one; 0: the scale never changes.
    """
    count = len(steps) + 1
    measuring = [loop for loop in loops if loop.scale.sigma > 0]
    if drift == 0 or not measuring:
        return np.zeros(count)
    match, query = np.array([(loop.match, loop.query) for loop in measuring]).T
    measured = np.array([loop.scale.log for loop in measuring])
    information = 1.0 / np.square([loop.scale.sigma for loop in measuring])
    chain = 1.0 / (drift**2 * np.maximum(steps, _MIN_STEP))
    before = np.arange(count - 1)
    logs, weights = np.zeros(count), _initial_weights(match, query, steps, drift, measured, information)
    for _ in range(_ITERATIONS):
        first, second = np.concatenate([before, match]), np.concatenate([before + 1, query])
        weighted = np.concatenate([chain, weights * information])
        logs = _solve_differences(first, second, np.concatenate([np.zeros(count - 1), measured]), weighted)
        chi2 = information * (logs[query] - logs[match] - measured) ** 2
        weights = 1.0 / (1.0 + chi2 / _KERNEL_CHI2) ** 2
    return logs


def _initial_weights(
    match: Rows, query: Rows, steps: Array, drift: float, measured: Array, information: Array
) -> Array:
    """Weights (L,) of the loops by what drift alone explains: the kernel must not start at no drift at all."""
    path_length = np.concatenate([[0.0], np.cumsum(steps)])
    variance = 1.0 / information + drift**2 * (path_length[query] - path_length[match])
    return np.asarray(1.0 / (1.0 + measured**2 / variance / _KERNEL_CHI2) ** 2)


def _solve_differences(first: Rows, second: Rows, measured: Array, weights: Array) -> Array:
    """Values (N,), the first 0, whose differences fit measured ones (M,) best under weights (M,)."""
    count = int(second.max()) + 1
    rows = np.concatenate([first, second, first, second])
    columns = np.concatenate([first, second, second, first])
    H = coo_matrix((np.concatenate([weights, weights, -weights, -weights]), (rows, columns)), (count, count)).tocsc()
    b = np.bincount(second, weights * measured, count) - np.bincount(first, weights * measured, count)
    return np.concatenate([[0.0], spsolve(H[1:, 1:], b[1:])])
