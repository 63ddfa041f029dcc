"""How the unit of one camera's odometry has drifted, from loops that compare it: a graph of one number a frame.

Scale multiplies along the way, so its logarithm adds up and the graph is linear: what is robust about it are
the weights of the loops (Geman and McClure). It is solved before the poses, so that those know of no scale.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import spsolve

from slam.loop_closing import LoopClosure

Array = NDArray[np.float64]

_ROUNDS = 20  # of reweighting
_WIDTH = 9.0  # squared error of a loop, in variances, at which its weight is a quarter


def unit_logs(steps: Array, loops: Sequence[LoopClosure], drift: float) -> Array:
    """Logarithm (N,) of the unit of each frame in that of the first.

    Args:
        steps: (N - 1,) way from each frame to the next.
        loops: with the units of their two frames compared.
        drift: standard deviation of the logarithm's change over a way of one; 0: the unit never changes.
    """
    count = len(steps) + 1
    told = [loop for loop in loops if loop.unit.sigma > 0]
    if drift == 0 or not told:
        return np.zeros(count)
    match, query = np.array([(loop.match, loop.query) for loop in told]).T
    measured = np.array([loop.unit.log for loop in told])
    information = 1.0 / np.square([loop.unit.sigma for loop in told])
    chain = 1.0 / (drift**2 * np.maximum(steps, 1e-3))
    before = np.arange(count - 1)
    logs, weights = np.zeros(count), _first_weights(match, query, steps, drift, measured, information)
    for _ in range(_ROUNDS):
        first, second = np.concatenate([before, match]), np.concatenate([before + 1, query])
        trust = np.concatenate([chain, weights * information])
        logs = _solved(first, second, np.concatenate([np.zeros(count - 1), measured]), trust)
        chi2 = information * (logs[query] - logs[match] - measured) ** 2
        weights = 1.0 / (1.0 + chi2 / _WIDTH) ** 2
    return logs


def _first_weights(
    match: NDArray[np.int64], query: NDArray[np.int64], steps: Array, drift: float, measured: Array, information: Array
) -> Array:
    """Weights (L,) of the loops by what drift alone explains."""
    way = np.concatenate([[0.0], np.cumsum(steps)])
    variance = 1.0 / information + drift**2 * (way[query] - way[match])
    return np.asarray(1.0 / (1.0 + measured**2 / variance / _WIDTH) ** 2)


def _solved(first: NDArray[np.int64], second: NDArray[np.int64], measured: Array, trust: Array) -> Array:
    """Values (N,), the first 0, whose differences are best as measured (M,), under weights (M,)."""
    count = int(second.max()) + 1
    rows = np.concatenate([first, second, first, second])
    columns = np.concatenate([first, second, second, first])
    H = coo_matrix((np.concatenate([trust, trust, -trust, -trust]), (rows, columns)), (count, count)).tocsc()
    b = np.bincount(second, trust * measured, count) - np.bincount(first, trust * measured, count)
    return np.concatenate([[0.0], spsolve(H[1:, 1:], b[1:])])
