"""How much a loop's error speaks for it, on a scale that the data themselves set.

A true loop misses the pose that the other edges predict by an error of Student's distribution, a Gaussian
whose covariance is not quite known; a false one by anything that the extent of the map allows. The logarithm
of the ratio of the two densities is the evidence. It asks more than a gate does: where the prediction is
vague, agreement proves little.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln
from scipy.stats import chi2 as chi2_distribution
from scipy.stats import f as f_distribution

from slam.pose_graph_edges import Edges
from slam.pose_graph_posterior import Posterior, posterior

Array = NDArray[np.float64]

CONFIDENCE = 1.0 - 1e-4  # share of true loops within the limit
LEAST_EVIDENCE = 3.0  # nats: twenty times likelier true than false
FREEDOM = 5.0  # degrees of freedom of Student's distribution: how far covariances differ from edge to edge
_FREEDOMS = FREEDOM * 2.0 ** np.arange(0.0, 5.0)  # that the loops in use may turn out to have
_ORDINARY = 10.0  # degrees of freedom of ordinary errors
_TWICE_AS_FAR = 4.0  # in chi-square
_SCALE_STEPS = 10
_NEVER = 1e-4  # share of true loops that lie beyond the farthest that is believed
_HALF = 0.5  # of what is known about a loop
_LEAST_LEFT = 0.1  # of a loop's covariance, after the fit has taken its share
_FLATTEST = 1e-3  # variance of the thinnest side of a map, relative to the widest


@dataclass(frozen=True)
class Evidence:
    """What the rest of a graph says about loops.

    Attributes:
        loops: L edges.
        errors: (L, dof) at the poses.
        spread: (L, dof, dof) covariance of what the graph predicts, at scale one.
        log_volume: of all relative poses that the map allows.
        posterior: of the poses, by the graph.
        freedom: of the tails of true loops' errors.
        rare: chi-square that one in a hundred of the loops in use exceeds, in units of the scale.
    """

    loops: Edges
    errors: Array
    spread: Array
    log_volume: float
    posterior: Posterior
    freedom: float = FREEDOM
    rare: float = 0.0

    @property
    def dof(self) -> int:
        """Of an error."""
        return self.errors.shape[1]

    @cached_property
    def chi2(self) -> Array:
        """(L,) squared errors under prediction and measurement, at scale one."""
        return _squared(self.spread + self.loops.covariance, self.errors)

    def at(self, scale: float) -> Array:
        """(L,) nats in favour of each loop, with covariances multiplied by a scale."""
        return self.nats(self.chi2, _log_det(self.spread + self.loops.covariance), scale)

    def alone(self, scale: float) -> Array:
        """(L,) nats where the prediction is taken for the truth, so that only the loop's own error is left."""
        return self.nats(_squared(self.loops.covariance, self.errors), _log_det(self.loops.covariance), scale)

    def without_itself(self, scale: float) -> Array:
        """(L,) nats in favour of each loop that the graph leans on, by the graph without that loop.

        With posterior spread P and measurement R the prediction without the loop has covariance
        R (R - P)^-1 R, and the error there is R (R - P)^-1 times that of the fit.
        """
        log_det = _log_det(self.loops.covariance) - np.log(self._left).sum(axis=1)
        return self.nats(self.chi2_without_itself, log_det, scale)

    @cached_property
    def chi2_without_itself(self) -> Array:
        """(L,) squared errors that loops in use would have if they were not, at scale one."""
        errors = np.einsum("mji,mj->mi", self._shares[1], np.einsum("mij,mj->mi", self.loops.root, self.errors))
        return np.asarray((np.square(errors) / self._left).sum(axis=1))

    @property
    def supported(self) -> NDArray[np.bool_]:
        """(L,) loops in use of which others say as much, in some direction, as the loops themselves."""
        enough: NDArray[np.bool_] = self.reliance < _HALF
        return enough

    @property
    def _left(self) -> Array:
        """(L, dof) of each loop's covariance, by direction, once the fit has taken its share."""
        return np.maximum(1.0 - self._shares[0], _LEAST_LEFT)

    @cached_property
    def reliance(self) -> Array:
        """(L,) the least share, over directions, that a loop in use has in what is known about it."""
        return np.asarray(self._shares[0][:, 0])

    @cached_property
    def _shares(self) -> tuple[Array, Array]:
        """Eigenvalues (L, dof) of the spread in units of each loop's own covariance, and the directions."""
        whiten = self.loops.root
        values, vectors = np.linalg.eigh(whiten @ self.spread @ np.swapaxes(whiten, 1, 2))
        return values / self.posterior.inflation, vectors

    def nats(self, chi2: Array, log_det: Array, scale: float) -> Array:
        """(M,) nats in favour of errors with these chi-squares and log-determinants, covariances times a scale."""
        spread = 0.5 * (log_det + self.dof * np.log(2.0 * np.pi * scale))
        nats = self.log_volume - spread + log_density(chi2 / scale, self.dof, self.freedom)
        bound = max(farthest(self.dof), _TWICE_AS_FAR * self.rare)
        return np.where(chi2 <= scale * bound, nats, -np.inf)


def log_density(chi2: Array, dof: int, freedom: float) -> Array:
    """Logarithm of Student's density of errors with these chi-squares, less that of a Gaussian at its centre."""
    half = 0.5 * (freedom + dof)
    peak = gammaln(half) - gammaln(0.5 * freedom) - 0.5 * dof * np.log(0.5 * freedom)
    return np.asarray(peak - half * np.log1p(chi2 / freedom))


def student_scale(chi2: Array, dof: int, freedom: float) -> float:
    """Variance factor under which chi-squares are likeliest Student's (Lange et al., JASA 1989)."""
    factor = max(float(np.median(chi2)) / dof, np.finfo(float).tiny)
    for _ in range(_SCALE_STEPS):
        factor = float(((freedom + dof) / (freedom + chi2 / factor) * chi2).mean()) / dof
    return max(factor, np.finfo(float).tiny)


def freedom_of(chi2: Array, dof: int) -> float:
    """How light the tails of errors are that have these chi-squares (M,), the heaviest if all are alike."""

    def score(freedom: float) -> float:
        scale = student_scale(chi2, dof, freedom)
        return float((log_density(chi2 / scale, dof, freedom) - 0.5 * dof * np.log(scale)).sum())

    return float(max(_FREEDOMS, key=score))


def evidence(poses: Array, support: Edges, loops: Edges) -> Evidence:
    """Judge loops by the poses (N, n, n) and by the posterior of the edges that support them."""
    belief = posterior(poses, support)
    return Evidence(loops, loops.errors(poses), belief.spread(loops), log_volume(poses), belief)


def _squared(covariance: Array, errors: Array) -> Array:
    """(L,) chi-squares of errors (L, dof)."""
    solved = np.linalg.solve(covariance, errors[..., None])[..., 0]
    return np.asarray((errors * solved).sum(axis=1))


def _log_det(covariance: Array) -> Array:
    return np.asarray(np.linalg.slogdet(covariance)[1])


def limit(dof: int) -> float:
    """Chi-square that a true loop exceeds once in ten thousand times."""
    return float(chi2_distribution.ppf(CONFIDENCE, dof))


def farthest(dof: int) -> float:
    """Chi-square beyond which no volume is large enough to make a loop true, unless those in use go as far."""
    return float(dof * f_distribution.isf(_NEVER, dof, _ORDINARY))


def log_volume(poses: Array) -> float:
    """Logarithm of the volume of poses within the extent of a trajectory (N, n, n): metres and radians."""
    positions = poses[:, :-1, -1]
    spread = np.atleast_1d(np.linalg.eigvalsh(np.cov(positions.T)))
    sides = np.sqrt(12.0 * np.maximum(spread, _FLATTEST * spread.max()))
    turns = 2.0 * np.pi if positions.shape[1] == 2 else 8.0 * np.pi**2
    return float(np.log(np.maximum(sides, 1e-9)).sum() + np.log(turns))
