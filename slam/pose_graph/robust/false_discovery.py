"""False discovery control: which kept loops could be false by chance, estimated from the loops that were left out.

Where only odometry constrains a place, its drift may explain a false loop as well as a true one. One false
loop in exp(e) has a log likelihood ratio of e or more; how many false loops that makes follows from the best of
those left out (an empirical null: Efron, JASA 2004). Kept loops are then tested together at a false discovery rate
(Benjamini and Hochberg, JRSS B 1995): a few loops must be more certain than many.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Of 144 graphs with few true loops 6 keep a false one at this rate, and 16 at 0.05.
RATE = 0.01  # expected share of false loops among those kept
SECOND_RATE = 0.25 * RATE  # for loops that have failed a first test
_NULL_SAMPLE = 3  # loops: the best of those left out, from which the number of false ones follows
# As many true loops may have been left out, and look better than any false one: they are no sample of the false.
_MAX_TRUE_LEFT_OUT = 0.02  # of the kept loops


def not_significant(kept: Mask, false_positives: Array, rate: float = RATE) -> Mask:
    """(L,) kept loops that may have been kept by chance.

    Args:
        kept: (L,) bool, the loops to test.
        false_positives: (L,) number of false loops to expect that look as good as each.
        rate: false discovery rate.
    """
    failed = np.zeros_like(kept)
    failed[kept] = ~benjamini_hochberg(false_positives[kept], rate)
    return failed


def expected_false_positives(log_ratio: Array, kept: Mask) -> Array:
    """(L,) number of false loops to expect with a log likelihood ratio as high as each, by the best left out."""
    best = np.sort(log_ratio[~kept])[::-1][int(_MAX_TRUE_LEFT_OUT * kept.sum()) :][:_NULL_SAMPLE]
    if not np.isfinite(best[-1:]).any():
        return np.zeros(len(log_ratio))
    return np.asarray(len(best) * np.exp(best[-1] - np.maximum(log_ratio, best[-1])))


def benjamini_hochberg(false_positives: Array, rate: float) -> Mask:
    """(M,) bool, the discoveries: their expected number of false ones is at most `rate` of all that are as good."""
    order = np.argsort(false_positives, kind="stable")
    within = np.flatnonzero(false_positives[order] <= rate * np.arange(1, len(false_positives) + 1))
    discovered = np.zeros(len(false_positives), dtype=bool)
    discovered[order[: within[-1] + 1 if len(within) else 0]] = True
    return discovered
