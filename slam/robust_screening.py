"""A first look at each loop by itself, on a scale of all covariances that the data set.

Stated covariances are wrong by one factor or another, so all of them are multiplied by a scale. It is the one
that explains the loops best, near what the roughness of odometry allows: scaling every covariance of a graph
changes no verdict.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.pose_graph_edges import Edges
from slam.robust_condensed import Condensed, condensed
from slam.robust_evidence import LEAST_EVIDENCE, Evidence, evidence, limit
from slam.robust_problem import LoopProblem

Array = NDArray[np.float64]

# Errors of odometry that persist add up: over a long way the variance is up to this many times what the
# roughness of single steps shows. Measured: 15 to 70 on real drives, 1 to 5 in simulated graphs.
_PERSISTENCE = 100.0
_ROUGHEST = 100.0  # real motion may look like so much more noise than there is
_MARGIN = np.log(1.5)  # width of the soft ends of that range
_OCTAVES = np.arange(-16.0, 16.5, 0.5)
_WIDE = 2.0  # of a gate on single loops, over the limit: covariances are not quite known
_MIXTURE_ODDS = LEAST_EVIDENCE
_NO_NOISE = 1e-4  # roughness of odometry that was made, not measured


@dataclass(frozen=True)
class Screening:
    """Each loop judged by itself, before any is believed.

    Attributes:
        small: the problem without the poses that no loop touches.
        found: the evidence, by the small problem.
        scale: of all covariances.
        limit: chi-square, as stated, that a true loop seldom exceeds once the map is right.
    """

    small: Condensed
    found: Evidence
    scale: float
    limit: float

    @property
    def passed(self) -> NDArray[np.bool_]:
        """(L,) loops that drift explains."""
        gate: NDArray[np.bool_] = self.found.chi2 <= _WIDE * self.limit
        return gate


def screened(problem: LoopProblem) -> Screening:
    """Judge loops by the poses that trusted edges alone lead to."""
    small = condensed(problem)
    found = evidence(small.problem.start, small.problem.trusted, small.problem.loops)
    scale = calibrated(found, roughness(problem.trusted))  # from every step: condensed ones are smooth
    return Screening(small, found, scale, limit(problem.loops.group.dof) * scale)


def calibrated(found: Evidence, roughness: float) -> float:
    """Scale of all covariances under which loops, true ones mixed with false, are likeliest."""
    scales = roughness * 2.0**_OCTAVES
    below = np.maximum(np.log(roughness / _ROUGHEST / scales), 0.0)
    above = np.maximum(np.log(scales / (roughness * _PERSISTENCE)), 0.0)
    doubt = 0.5 * np.square((below + above) / _MARGIN)
    scores = [np.logaddexp(0.0, found.at(scale) - _MIXTURE_ODDS).sum() for scale in scales]
    return float(scales[np.argmax(np.array(scores) - doubt)])


def roughness(trusted: Edges) -> float:
    """Variance of odometry's steps over what is stated, from how little smooth motion explains them.

    High differences of the motions take away what changes slowly; the least over four orders and the median
    over the components also stand corners and stops. Odometry without any noise says nothing: one.
    """
    order = np.argsort(trusted.first, kind="stable")
    steps = trusted.group.log(trusted.motions[order])
    root = np.median(trusted.root, axis=0)
    found = [_scatter(steps, times, root) for times in range(1, 5) if len(steps) > 2 * times]
    least = min(found, default=1.0)
    return least if least > _NO_NOISE else 1.0


def _scatter(steps: Array, times: int, root: Array) -> float:
    """Robust variance of whitened differences, of independent errors once."""
    gain = np.sqrt(sum(c**2 for c in _binomials(times)))
    scatter = np.abs(np.diff(steps, times, axis=0) @ root.T) / gain
    return float(np.median(np.square(1.4826 * np.median(scatter, axis=0))))


def _binomials(times: int) -> Array:
    return np.diff(np.eye(2 * times + 1)[times], times)
