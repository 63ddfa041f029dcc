"""Covariance scale and gate: each loop tested by itself against odometry, before any is accepted.

Stated covariances are wrong by one factor or another, so all of them are multiplied by one scale. It is the scale
that makes the loops most likely, within a range that the noise of odometry's single steps allows. Scaling every
covariance of a graph therefore changes no decision.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.pose_graph.optimization.edges import Edges
from slam.pose_graph.robust.likelihood_ratio import MIN_LOG_RATIO, LoopLikelihood, loop_likelihood, max_inlier_chi2
from slam.pose_graph.robust.problem import CondensedProblem, LoopProblem, condense

Array = NDArray[np.float64]

# Errors of odometry that persist add up: over a long path the variance is up to this many times that of the
# noise of single steps. Measured: 15 to 70 on real recordings, 1 to 5 in simulated graphs.
_MAX_PERSISTENCE = 100.0
_MAX_ROUGHNESS = 100.0  # real motion is rough: it may look like this many times the actual noise
_MARGIN = np.log(1.5)  # width of the soft ends of that range
_LOG2_SCALES = np.arange(-16.0, 16.5, 0.5)  # searched, around the noise of odometry's steps
_GATE_FACTOR = 2.0  # on the chi-square limit: the scale of single covariances is uncertain
_MIXTURE_LOG_ODDS = MIN_LOG_RATIO  # of false to true loops, in the likelihood of the scale
_MIN_NOISE_SCALE = 1e-4  # below it odometry was generated without noise
_MAD_TO_SIGMA = 1.4826  # of a Gaussian
_MAX_ORDER = 4  # of the differences that remove smooth motion


@dataclass(frozen=True)
class Screening:
    """Each loop tested by itself, before any is accepted.

    Attributes:
        condensed: the problem without the poses that no loop touches.
        likelihood: likelihood ratio of each loop by odometry alone, on the condensed problem.
        scale: covariance scale of the whole graph.
        max_inlier_chi2: chi-square, by stated covariances, that a true loop seldom exceeds once the map is right.
    """

    condensed: CondensedProblem
    likelihood: LoopLikelihood
    scale: float
    max_inlier_chi2: float

    @property
    def passed(self) -> NDArray[np.bool_]:
        """(L,) bool, loops that odometry's drift can explain."""
        gate: NDArray[np.bool_] = self.likelihood.chi2 <= _GATE_FACTOR * self.max_inlier_chi2
        return gate


def screen(problem: LoopProblem) -> Screening:
    """Test each loop against the poses that the trusted edges alone lead to."""
    condensed = condense(problem)
    likelihood = loop_likelihood(condensed.problem.start, condensed.problem.trusted, condensed.problem.loops)
    # The noise comes from every step of odometry: the composed steps of the condensed problem are smooth.
    scale = calibrate_covariance_scale(likelihood, odometry_noise_scale(problem.trusted))
    return Screening(condensed, likelihood, scale, max_inlier_chi2(problem.loops.group.dof) * scale)


def calibrate_covariance_scale(likelihood: LoopLikelihood, noise_scale: float) -> float:
    """Covariance scale under which the loops, a mixture of true and false ones, are most likely.

    Args:
        likelihood: likelihood ratio of each loop by odometry alone.
        noise_scale: variance of odometry's steps over the stated one; the scale may be `_MAX_PERSISTENCE` times
            larger, or `_MAX_ROUGHNESS` times smaller, before a penalty grows.
    """
    scales = noise_scale * 2.0**_LOG2_SCALES
    below = np.maximum(np.log(noise_scale / _MAX_ROUGHNESS / scales), 0.0)
    above = np.maximum(np.log(scales / (noise_scale * _MAX_PERSISTENCE)), 0.0)
    penalty = 0.5 * np.square((below + above) / _MARGIN)
    # A false loop has log-likelihood 0 in this mixture, a true one its ratio less the odds against it.
    scores = [np.logaddexp(0.0, likelihood.log_ratio_at(scale) - _MIXTURE_LOG_ODDS).sum() for scale in scales]
    return float(scales[np.argmax(np.array(scores) - penalty)])


def odometry_noise_scale(trusted: Edges) -> float:
    """Variance of odometry's steps over the stated one, from what smooth motion does not explain.

    Differences of the motions remove what changes slowly. The smallest of four orders and the median over the
    components are robust to corners and stops. Odometry without any noise gives one.
    """
    order = np.argsort(trusted.first, kind="stable")
    steps = trusted.group.log(trusted.motions[order])
    sqrt_information = np.median(trusted.sqrt_information, axis=0)
    orders = range(1, _MAX_ORDER + 1)
    variances = [_difference_variance(steps, k, sqrt_information) for k in orders if len(steps) > 2 * k]
    smallest = min(variances, default=1.0)
    return smallest if smallest > _MIN_NOISE_SCALE else 1.0


def _difference_variance(steps: Array, order: int, sqrt_information: Array) -> float:
    """Robust variance of whitened differences of an order, normalised to one for independent unit noise."""
    # Differences of independent noise have a variance of the sum of squared binomial coefficients.
    gain = np.sqrt(sum(c**2 for c in _binomials(order)))
    scatter = np.abs(np.diff(steps, order, axis=0) @ sqrt_information.T) / gain
    return float(np.median(np.square(_MAD_TO_SIGMA * np.median(scatter, axis=0))))


def _binomials(order: int) -> Array:
    """Binomial coefficients of an order, with alternating signs: a difference of a unit impulse."""
    return np.diff(np.eye(2 * order + 1)[order], order)
