"""Covariance of the relative pose of any two poses of a graph, from samples of its posterior.

A marginal for every proposed loop would need as many solves as there are loops; a fixed number of samples
gives all of them at once (perturb-and-solve: Papandreou and Yuille, NIPS 2010).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.pose_graph_edges import Edges
from slam.pose_graph_lie import inverse
from slam.pose_graph_newton import factorize_jacobian, whitened_jacobian

Array = NDArray[np.float64]

SAMPLES = 48  # a variance is then known to a fifth of itself, one standard deviation: sqrt(2 / 48)


@dataclass(frozen=True)
class Posterior:
    """Samples of the Gaussian posterior of a graph around its poses.

    Attributes:
        poses: (N, n, n) mean of the posterior, metres.
        samples: (N, dof, S) right perturbations of the poses, the first pose held.
    """

    poses: Array
    samples: Array

    def relative_covariance(self, edges: Edges) -> Array:
        """Covariances (M, dof, dof) of the relative pose between the ends of each edge, without its own measurement.

        Scaled so that its inverse is unbiased (Hartlap et al., A&A 2007).
        """
        relative = inverse(self.poses[edges.second]) @ self.poses[edges.first]
        moved = edges.group.adjoint(relative) @ self.samples[edges.first]
        difference = self.samples[edges.second] - moved
        return difference @ np.swapaxes(difference, 1, 2) / self._divisor

    @property
    def inflation(self) -> float:
        """Expected `relative_covariance` over the true covariance."""
        return self.samples.shape[2] / self._divisor

    @property
    def _divisor(self) -> int:
        return self.samples.shape[2] - self.samples.shape[1] - 1


def sample_posterior(poses: Array, edges: Edges, seed: int = 0) -> Posterior:
    """Sample the posterior of a connected graph at poses (N, n, n), the first pose held."""
    dof = edges.group.dof
    jacobian = whitened_jacobian(poses, edges)[:, dof:]
    # The least-squares answer to unit noise in the whitened errors is a sample of the posterior.
    noise = np.random.default_rng(seed).normal(size=(jacobian.shape[0], SAMPLES))
    moved = factorize_jacobian(jacobian).solve(jacobian.T @ noise)
    samples = np.concatenate([np.zeros((dof, SAMPLES)), moved]).reshape(len(poses), dof, SAMPLES)
    return Posterior(poses, samples)
