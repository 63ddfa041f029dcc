"""Likelihood ratio of a loop: how much more likely its error is for a true loop than for a false one.

A true loop differs from the pose that the other edges predict by an error of Student's distribution, a Gaussian whose
covariance is not quite known. A false loop measures any pose within the extent of the map. The logarithm of the ratio
of the two densities, in nats, is stricter than a gate: where the prediction is uncertain, agreement is weak evidence.
Derivation: docs/math.md.

Where only odometry constrains a place, its drift may explain a false loop as well as a true one. One false loop in
exp(e) has a log likelihood ratio of e or more; how many false loops that makes follows from the best of those left out
(an empirical null: Efron, JASA 2004). Kept loops are then tested together at a false discovery rate (Benjamini and
Hochberg, JRSS B 1995): a few loops must be more certain than many.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincinv, gammainccinv, gammaln

from slam.pose_graph.optimization.edges import Edges
from slam.pose_graph.optimization.lie_groups import LieGroup
from slam.pose_graph.optimization.marginals import Posterior, sample_posterior

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_OUTLIER_SHARE = 1e-4  # of true loops, beyond the chi-square limit
MIN_LOG_RATIO = 3.0  # nats: a true loop is twenty times as likely
STUDENT_DOF = 5.0  # degrees of freedom of Student's distribution: how far covariances differ from edge to edge
_STUDENT_DOFS = STUDENT_DOF * 2.0 ** np.arange(0.0, 5.0)  # candidates, for the errors of the kept loops
# The farthest a true loop may lie: a quantile of the F distribution, or twice as far as one in a hundred of the
# kept loops. Without an end Student's tail would let the volume of a large map make any loop true.
_TAIL_DOF = 10.0
_TAIL_PROBABILITY = 1e-4
_MAX_TAIL_FACTOR = 4.0  # in chi-square: twice as far
_SCALE_ITERATIONS = 10  # EM steps of Student's distribution
_MAX_OWN_SHARE = 0.5  # of the information about a loop: the other loops have as much as the loop itself
# The share that a fit leaves of a loop's covariance is a difference of nearly equal, sampled numbers near zero.
_MIN_COVARIANCE_LEFT = 0.1
_MIN_SIDE_VARIANCE = 1e-3  # of the thinnest side of a map, relative to the widest: a flat map has volume too
# Of 144 graphs with few true loops 6 keep a false one at this rate, and 16 at 0.05.
FALSE_DISCOVERY_RATE = 0.01  # expected share of false loops among those kept
STRICT_FALSE_DISCOVERY_RATE = 0.25 * FALSE_DISCOVERY_RATE  # for loops that have failed a first test
_NULL_SAMPLE = 3  # loops: the best of those left out, from which the number of false ones follows
# As many true loops may have been left out, and look better than any false one: they are no sample of the false.
_MAX_TRUE_LEFT_OUT = 0.02  # of the kept loops


@dataclass(frozen=True)
class LoopLikelihood:
    """Likelihood ratios of loops by the rest of a graph.

    Attributes:
        loops: L edges.
        errors: (L, dof) errors of the loops at the poses of the graph.
        relative_covariance: (L, dof, dof) covariance of the relative poses that the graph predicts, at scale one.
        log_volume: logarithm of the volume of all relative poses within the extent of the map.
        posterior: samples of the poses' posterior.
        student_dof: degrees of freedom of the errors of true loops.
        tail_chi2: chi-square that one in a hundred of the kept loops exceeds, over the scale.
    """

    loops: Edges
    errors: Array
    relative_covariance: Array
    log_volume: float
    posterior: Posterior
    student_dof: float = STUDENT_DOF
    tail_chi2: float = 0.0

    @property
    def dof(self) -> int:
        """Dimension of an error: 3 in the plane, 6 in space."""
        return self.errors.shape[1]

    @cached_property
    def chi2(self) -> Array:
        """(L,) predictive chi-square: errors under the covariances of prediction and measurement, at scale one."""
        return _mahalanobis(self.relative_covariance + self.loops.covariance, self.errors)

    def log_ratio_at(self, scale: float) -> Array:
        """(L,) log likelihood ratio of each loop, all covariances multiplied by a scale."""
        return self.log_ratio(self.chi2, _log_det(self.relative_covariance + self.loops.covariance), scale)

    def log_ratio_at_fit(self, scale: float) -> Array:
        """(L,) log likelihood ratio if the prediction is exact, so that only the loop's own error is left."""
        return self.log_ratio(_mahalanobis(self.loops.covariance, self.errors), _log_det(self.loops.covariance), scale)

    def leave_one_out(self, scale: float) -> Array:
        """(L,) log likelihood ratio of each kept loop by the graph without that loop.

        With posterior covariance P and measurement covariance R, the prediction without the loop differs from the
        measurement by R (R - P)^-1 times the error of the fit, with covariance R (R - P)^-1 R.
        """
        log_det = _log_det(self.loops.covariance) - np.log(self._covariance_left).sum(axis=1)
        return self.log_ratio(self.chi2_leave_one_out, log_det, scale)

    @cached_property
    def chi2_leave_one_out(self) -> Array:
        """(L,) predictive chi-square of each kept loop by the graph without that loop, at scale one."""
        whitened = np.einsum("mij,mj->mi", self.loops.sqrt_information, self.errors)
        errors = np.einsum("mji,mj->mi", self._shares[1], whitened)
        return np.asarray((np.square(errors) / self._covariance_left).sum(axis=1))

    @property
    def is_supported(self) -> NDArray[np.bool_]:
        """(L,) bool, kept loops about which the others know as much, in some direction, as the loops themselves."""
        enough: NDArray[np.bool_] = self.own_share < _MAX_OWN_SHARE
        return enough

    @property
    def _covariance_left(self) -> Array:
        """(L, dof) share of each loop's covariance, by direction, that the fit has left."""
        return np.maximum(1.0 - self._shares[0], _MIN_COVARIANCE_LEFT)

    @cached_property
    def own_share(self) -> Array:
        """(L,) smallest share, over directions, that a kept loop has in the information about its relative pose."""
        return np.asarray(self._shares[0][:, 0])

    @cached_property
    def _shares(self) -> tuple[Array, Array]:
        """Eigenvalues (L, dof) of P in units of each loop's own covariance R, and the directions."""
        whiten = self.loops.sqrt_information
        values, vectors = np.linalg.eigh(whiten @ self.relative_covariance @ np.swapaxes(whiten, 1, 2))
        return values / self.posterior.inflation, vectors

    def log_ratio(self, chi2: Array, log_det: Array, scale: float) -> Array:
        """(M,) log likelihood ratio of errors.

        Args:
            chi2: (M,) chi-squares at scale one.
            log_det: (M,) log-determinants of their covariances at scale one.
            scale: factor on all covariances.
        """
        log_normalization = 0.5 * (log_det + self.dof * np.log(2.0 * np.pi * scale))
        density = log_density(chi2 / scale, self.dof, self.student_dof)
        # A prediction wider than the map says nothing: a true loop lies within the map too.
        log_peak = np.maximum(
            self.log_volume - log_normalization, -log_density(np.zeros(1), self.dof, self.student_dof)
        )
        log_ratio = log_peak + density
        bound = max(max_true_chi2(self.dof), _MAX_TAIL_FACTOR * self.tail_chi2)
        return np.where(chi2 <= scale * bound, log_ratio, -np.inf)


def log_density(chi2: Array, dof: int, student_dof: float) -> Array:
    """(M,) logarithm of Student's density of errors with these chi-squares, less that of a Gaussian at its centre."""
    half = 0.5 * (student_dof + dof)
    peak = gammaln(half) - gammaln(0.5 * student_dof) - 0.5 * dof * np.log(0.5 * student_dof)
    return np.asarray(peak - half * np.log1p(chi2 / student_dof))


def student_scale(chi2: Array, dof: int, student_dof: float) -> float:
    """Variance factor of greatest likelihood of chi-squares (M,) of Student's errors (Lange et al., JASA 1989)."""
    factor = max(float(np.median(chi2)) / dof, np.finfo(float).tiny)
    for _ in range(_SCALE_ITERATIONS):
        factor = float(((student_dof + dof) / (student_dof + chi2 / factor) * chi2).mean()) / dof
    return max(factor, np.finfo(float).tiny)


def estimate_student_dof(chi2: Array, dof: int) -> float:
    """Degrees of freedom that make chi-squares (M,) most likely; the heaviest tails if all are alike."""

    def score(student_dof: float) -> float:
        scale = student_scale(chi2, dof, student_dof)
        return float((log_density(chi2 / scale, dof, student_dof) - 0.5 * dof * np.log(scale)).sum())

    return float(max(_STUDENT_DOFS, key=score))


def loop_likelihood(poses: Array, support: Edges, loops: Edges) -> LoopLikelihood:
    """Likelihood of loops at poses (N, n, n) by the posterior of the edges that support these."""
    posterior = sample_posterior(poses, support)
    covariance = posterior.relative_covariance(loops)
    return LoopLikelihood(loops, loops.errors(poses), covariance, log_volume(poses, loops.group), posterior)


def _mahalanobis(covariance: Array, errors: Array) -> Array:
    """(L,) chi-squares of errors (L, dof) under covariances (L, dof, dof)."""
    whitened = np.linalg.solve(covariance, errors[..., None])[..., 0]
    return np.asarray((errors * whitened).sum(axis=1))


def _log_det(covariance: Array) -> Array:
    return np.asarray(np.linalg.slogdet(covariance)[1])


def max_inlier_chi2(dof: int) -> float:
    """Chi-square that one true loop in ten thousand exceeds."""
    return 2.0 * float(gammainccinv(dof / 2, _OUTLIER_SHARE))


def max_true_chi2(dof: int) -> float:
    """Chi-square beyond which no loop is true, however large the map, unless the kept loops go as far."""
    # The quantile of the F distribution by its beta function: scipy.stats would take 20 MB.
    return _TAIL_DOF * (1.0 / float(betaincinv(_TAIL_DOF / 2, dof / 2, _TAIL_PROBABILITY)) - 1.0)


def log_volume(poses: Array, group: LieGroup) -> float:
    """Logarithm of the volume of poses within the extent of a trajectory (N, n, n), in metres and radians.

    The extent is a box with the second moments of the positions; all rotations of the group are possible.
    """
    positions = poses[:, :-1, -1]
    variances = np.atleast_1d(np.linalg.eigvalsh(np.cov(positions.T)))
    # A uniform distribution over a length s has the variance s^2 / 12.
    sides = np.sqrt(12.0 * np.maximum(variances, _MIN_SIDE_VARIANCE * variances.max()))
    return float(np.log(np.maximum(sides, 1e-9)).sum() + np.log(group.volume_of_rotations))


def not_significant(kept: Mask, false_positives: Array, rate: float = FALSE_DISCOVERY_RATE) -> Mask:
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
