"""What a back end is given and what it answers."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.pose_graph_edges import Edges, joined

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class LoopProblem:
    """Trusted edges that hold all poses together, and loops that must earn their trust.

    Attributes:
        trusted: edges such as odometry, without which the graph falls apart.
        loops: L edges, some of them false.
        start: (N, n, n) poses that the trusted edges lead to; the first one stays where it is.
    """

    trusted: Edges
    loops: Edges
    start: Array

    def using(self, chosen: Mask) -> Edges:
        """Trusted edges, then the chosen loops (L,)."""
        return joined(self.trusted, self.loops[chosen])

    def error(self, chosen: Mask, poses: Array) -> float:
        """Half chi-square of the trusted edges and the chosen loops (L,) at poses (N, n, n)."""
        return 0.5 * float(self.using(chosen).chi2(poses).sum())


@dataclass(frozen=True)
class Outcome:
    """What a back end decided.

    Attributes:
        poses: (N, n, n), metres.
        weights: (L,) trust in each loop, 0 to 1; a loop is kept from one half upwards.
        reasons: (L,) the verdicts in plain words.
    """

    poses: Array
    weights: Array
    reasons: tuple[str, ...]

    @property
    def kept(self) -> Mask:
        """(L,) the loops that the poses lean on."""
        return self.weights >= 0.5
