"""Leave-one-out test of loop clusters: each in turn is compared with the map that the others make.

A false cluster that odometry's drift can absorb lies close to the map that it has bent itself, however many true loops
there are; only the map without it tells.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

_REPRESENTATIVES = 6  # loops of a cluster that are used, evenly spread: neighbours measure nearly the same
_SUSPECT_RATIO = 0.5  # of the largest residual: clusters from there on are suspects; 0.8 loses to many false ones

PredictiveChi2 = Callable[[int, Sequence[int]], float]
"""Chi-square of a loop against the map that other loops make; loops by their numbers."""


class LeaveOneOutTest:
    """Finds the clusters to leave out, the worst first, until the others agree; one comparison a step.

    Args:
        clusters: loops of each cluster, by their numbers.
        predictive_chi2: chi-square of a loop against the map of others.
        limit: chi-square from which a cluster contradicts the others.

    Attributes:
        left_out: chi-square against the others of each cluster to leave out.
    """

    def __init__(self, clusters: Mapping[int, Sequence[int]], predictive_chi2: PredictiveChi2, limit: float) -> None:
        self._clusters, self._predictive_chi2, self._limit = dict(clusters), predictive_chi2, limit
        self._remaining = self._testable()
        self._results: dict[int, float] = {}
        self.left_out: dict[int, float] = {}

    def step(self) -> bool:
        """Compare one cluster with the others; whether the test is over."""
        if self._remaining:
            cluster = self._remaining.pop()
            others = [
                k for other, members in self._clusters.items() if other != cluster for k in _representatives(members)
            ]
            members = self._clusters[cluster]
            self._results[cluster] = self._predictive_chi2(members[len(members) // 2], others)
        return not self._remaining and not self._leave_out_worst()

    def _testable(self) -> list[int]:
        """Clusters to compare: a single loop is in the map only because it changes nothing there."""
        if len(self._clusters) < 2:
            return []
        return [cluster for cluster, members in self._clusters.items() if len(members) > 1]

    def _leave_out_worst(self) -> bool:
        """Leave out the cluster that contradicts the others most, if one does; whether the test goes on."""
        worst = max(self._results.values(), default=0.0)
        if worst <= self._limit:
            return False
        # Two clusters that contradict each other are equally far off: then the smaller one leaves. The ratio is of
        # residuals, hence its square for chi-squares.
        suspects = [cluster for cluster, chi2 in self._results.items() if chi2 >= _SUSPECT_RATIO**2 * worst]
        out = min(suspects, key=lambda cluster: (len(self._clusters[cluster]), -self._results[cluster]))
        self.left_out[out] = self._results[out]
        del self._clusters[out]
        self._results = {}
        self._remaining = self._testable()
        return bool(self._remaining)


def _representatives(members: Sequence[int]) -> list[int]:
    """A few loops of a cluster, evenly spread."""
    chosen = np.linspace(0, len(members) - 1, min(len(members), _REPRESENTATIVES)).round()
    return [members[int(k)] for k in chosen]
