"""Loops of one stretch of way that agree with one another, and what a group says of another.

Agreement is pairwise consistency (Mangelson et al., ICRA 2018, equation 3): the cycle through two loops and the
odometry between their ends must close. Over a short stretch odometry hardly drifts, so that agreement means much.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from slam.loop_closing import LoopClosure
from slam.pose_graph_drift import OdometryChain
from slam.pose_graph_what_if import surprise_by_others

Array = NDArray[np.float64]

_NEIGHBOURS = 12  # earlier loops of the stretch that are asked, the latest first


@dataclass(frozen=True)
class GroupConfig:
    """When loops belong together."""

    reach: float = 30.0  # metres of way within which two loops are of one stretch
    agreement_chi2: float = 22.5  # 99.9 % of 6 dof: two loops of one stretch further apart contradict each other
    width: float = 4.0  # Huber width of a loop, sigmas, where groups are compared


@dataclass(frozen=True)
class KnownLoop:
    """A loop between frames, the same between their keys, and the first loop of its group."""

    loop: LoopClosure
    tied: LoopClosure
    group: int


class LoopGroups:
    """Grows by loops as they come; a group is named by the number of its first loop."""

    def __init__(self, chain: OdometryChain, config: GroupConfig) -> None:
        self._chain, self._config = chain, config
        self._known: dict[int, KnownLoop] = {}
        self._members: dict[int, list[int]] = {}

    def __getitem__(self, number: int) -> KnownLoop:
        return self._known[number]

    @property
    def numbers(self) -> list[int]:
        """All loops, in the order in which they came."""
        return list(self._known)

    @property
    def names(self) -> list[int]:
        """All groups, in the order of their first loops."""
        return list(self._members)

    def members(self, group: int) -> list[int]:
        """Loops of a group, in the order in which they came."""
        return self._members[group]

    def add(self, number: int, loop: LoopClosure, tied: LoopClosure) -> list[int]:
        """Add a loop between frames, with the same one between keys, to the group of the latest that agrees.

        Returns:
            Loops of that group nearby, the latest first; none where it begins a group.
        """
        latest_first = reversed(self._known.items())
        near = list(islice((k for k, known in latest_first if self._of_one_stretch(known.loop, loop)), _NEIGHBOURS))
        agreeing = (k for k in near if self._disagreement(self._known[k].loop, loop) <= self._config.agreement_chi2)
        first = next(agreeing, None)
        group = number if first is None else self._known[first].group
        self._known[number] = KnownLoop(loop, tied, group)
        self._members.setdefault(group, []).append(number)
        return [k for k in near if self._known[k].group == group]

    def by_others(self, number: int, others: Sequence[int]) -> float:
        """Chi-square of a loop against the map that odometry and other loops alone would give."""
        loops, drift = [self._known[k].loop for k in others], self.drift(number, others)
        return surprise_by_others(self._known[number].loop, loops, self._chain, self._config.width, drift)

    def drift(self, number: int, others: Sequence[int]) -> Array:
        """Covariance (6, 6) of the drift that lasts, from the query to the nearest frame that another loop holds."""
        held = {frame for k in others for frame in (self._known[k].loop.query, self._known[k].loop.match)}
        query = self._known[number].loop.query
        nearest = min(held, key=lambda frame: (abs(frame - query), frame), default=0)
        return self._chain.lasting(nearest, query)

    def _of_one_stretch(self, a: LoopClosure, b: LoopClosure) -> bool:
        reach, way = self._config.reach, self._chain.way
        return abs(way(a.query) - way(b.query)) <= reach and abs(way(a.match) - way(b.match)) <= reach

    def _disagreement(self, a: LoopClosure, b: LoopClosure) -> float:
        """Chi-square of the cycle through two loops and the odometry between their ends."""
        matches, queries = self._chain.between(a.match, b.match), self._chain.between(a.query, b.query)
        by_a = a.T_match_query @ queries.T_first_second
        by_b = matches.T_first_second @ b.T_match_query
        covariance = se3.compose_covariance(a.covariance, queries.T_first_second, queries.covariance)
        covariance += se3.compose_covariance(matches.covariance, b.T_match_query, b.covariance)
        error = se3.log(se3.inverse(by_b) @ by_a)
        return float(error @ np.linalg.solve(covariance, error))
