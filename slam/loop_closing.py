"""From a belief to a loop closure: the six degrees of freedom between two images of one place."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LoopClosure:
    """A revisit proved by geometry.

    Attributes:
        query, match: frame indices, match < query.
        T_match_query: (4, 4) query camera in the match camera's frame, metres.
        covariance: (6, 6) of the right perturbation `T_match_query @ exp(xi)`, rotation first (rad, m).
        inliers: landmarks that agree with the motion.
    """

    query: int
    match: int
    T_match_query: Array
    covariance: Array
    inliers: int
