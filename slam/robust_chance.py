"""Which kept loops could be luck: the loops left out show how good false ones look by chance.

Where nothing but odometry speaks about a place, drift may explain a false loop as well as a true one. Of false
loops as many as 1 in exp(e) have evidence of e nats or more; how many that makes follows from the best of those
left out (an empirical null: Efron, JASA 2004). Kept loops are then tested together at a false discovery rate
(Benjamini and Hochberg, JRSS B 1995): a few loops must be surer than many.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

RATE = 0.01  # of false loops among those kept
SECOND_RATE = 0.25 * RATE  # where a first test failed
_NEAREST = 3  # of the loops left out that set the rate
_TRUE_OUT = 0.02  # of the kept loops: as many true ones may have been left out, and look better than any false one


def lucky(kept: Mask, chance: Array, rate: float = RATE) -> Mask:
    """(L,) kept loops that cannot be told from chance."""
    luck = np.zeros_like(kept)
    luck[kept] = ~discoveries(chance[kept], rate)
    return luck


def expected(nats: Array, kept: Mask) -> Array:
    """(L,) numbers of false loops to expect that have as much evidence as each, after the best of those left out."""
    best = np.sort(nats[~kept])[::-1][int(_TRUE_OUT * kept.sum()) :][:_NEAREST]
    if not np.isfinite(best[-1:]).any():
        return np.zeros(len(nats))
    return np.asarray(len(best) * np.exp(best[-1] - np.maximum(nats, best[-1])))


def discoveries(chance: Array, rate: float) -> Mask:
    """(M,) those whose expected number of false ones stays a small share of all that are as good."""
    order = np.argsort(chance, kind="stable")
    within = np.flatnonzero(chance[order] <= rate * np.arange(1, len(chance) + 1))
    found = np.zeros(len(chance), dtype=bool)
    found[order[: within[-1] + 1 if len(within) else 0]] = True
    return found
