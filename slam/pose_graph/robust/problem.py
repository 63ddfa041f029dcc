"""Input and output of a robust back end."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.pose_graph.optimization.edges import Edges, concatenate

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MIN_KEPT_WEIGHT = 0.5  # of a loop that counts as kept


@dataclass(frozen=True)
class LoopProblem:
    """Trusted edges that connect all poses, and loops, some of them possibly false.

    Attributes:
        trusted: edges such as odometry that are taken to be right; without them the graph falls apart.
        loops: L edges, some of them false.
        start: (N, n, n) poses that the trusted edges lead to, metres; the first one is held.
    """

    trusted: Edges
    loops: Edges
    start: Array

    def edges_with(self, chosen: Mask) -> Edges:
        """Trusted edges, then the chosen loops (L,) bool."""
        return concatenate(self.trusted, self.loops[chosen])

    def error(self, chosen: Mask, poses: Array) -> float:
        """Half the chi-square of the trusted edges and the chosen loops (L,) at poses (N, n, n)."""
        return 0.5 * float(self.edges_with(chosen).chi2(poses).sum())


@dataclass(frozen=True)
class BackEndResult:
    """Poses and loop weights of a back end.

    Attributes:
        poses: (N, n, n) optimised poses, metres.
        weights: (L,) weight of each loop, 0 to 1; a loop is kept from `MIN_KEPT_WEIGHT` upwards.
        reasons: (L,) why each loop was kept or left out; `slam.pose_graph.robust.backends.solve` fills them in.
    """

    poses: Array
    weights: Array
    reasons: tuple[str, ...]

    @property
    def kept(self) -> Mask:
        """(L,) bool, the loops that the poses are fitted to."""
        return self.weights >= MIN_KEPT_WEIGHT
