"""Which kept loops could be luck: the loops left out show how near false ones come by chance.

Where nothing but odometry speaks about a place, drift may explain a false loop as well as a true one. False loops
fill the space of errors evenly, so that their number within a chi-square c grows as c^(dof / 2); the rate follows
from the nearest of those left out (an empirical null: Efron, JASA 2004). Kept loops are then tested together at a
false discovery rate (Benjamini and Hochberg, JRSS B 1995): a few loops must be surer than many.
"""

import numpy as np
from numpy.typing import NDArray

from slam.robust_evidence import Evidence

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

RATE = 0.05  # of false loops among those kept
SECOND_RATE = 0.25 * RATE  # where a first test failed
_NEAREST = 3  # of the loops left out that set the rate
_TRUE_OUT = 0.02  # of the kept loops: as many true ones may have been left out, and nearer than any false one


def chances(kept: Mask, before: Evidence, after: Evidence) -> Array:
    """(L,) numbers of false loops to expect as near as each kept loop, by what speaks most for it.

    Args:
        kept: (L,) loops that are in.
        before: evidence by odometry alone.
        after: evidence by odometry and the kept loops.
    """
    chance = expected(before.volume, false_ones(before.volume, kept))
    supported = kept & after.supported
    by_others = expected(after.volume_without_itself, false_ones(after.volume, kept))
    chance[supported] = np.minimum(chance, by_others)[supported]
    return chance


def lucky(kept: Mask, chance: Array, rate: float = RATE) -> Mask:
    """(L,) kept loops that cannot be told from chance."""
    luck = np.zeros_like(kept)
    luck[kept] = ~discoveries(chance[kept], rate)
    return luck


def false_ones(volume: Array, kept: Mask) -> Array:
    """Volumes of the loops left out, less the nearest that may be true."""
    return np.sort(volume[~kept])[int(_TRUE_OUT * kept.sum()) :]


def expected(volume: Array, false: Array) -> Array:
    """(M,) number of false loops to expect within each of M volumes, after those of known false ones."""
    nearest = np.sort(false)[:_NEAREST]
    if not len(nearest):
        return np.zeros(len(volume))
    return np.asarray(len(nearest) * volume / max(float(nearest[-1]), np.finfo(float).tiny))


def discoveries(chance: Array, rate: float) -> Mask:
    """(M,) those whose expected number of false ones stays a small share of all that are as good."""
    order = np.argsort(chance, kind="stable")
    within = np.flatnonzero(chance[order] <= rate * np.arange(1, len(chance) + 1))
    found = np.zeros(len(chance), dtype=bool)
    found[order[: within[-1] + 1 if len(within) else 0]] = True
    return found
