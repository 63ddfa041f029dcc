"""Which loops the map leans on while driving: none by itself, and none against the others.

A loop that drift can explain may still be false, and nothing at that moment tells. So it waits until a second
one of the same stretch agrees with it (pairwise consistency: Mangelson et al., ICRA 2018, equation 3). With
such a companion it must be one that the map, as sure as it is, does not exclude; a group that the map excludes
is tried against it whenever it has doubled, and stays if that leaves more loops in agreement.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from slam.loop_closing import LoopClosure
from slam.pose_graph_drift import OdometryChain
from slam.pose_graph_keys import KeyChain
from slam.pose_graph_online import IncrementalMap
from slam.robust import LoopGate

Array = NDArray[np.float64]

_COMPANIONS = 12  # earlier loops of the stretch that are asked, the latest first
_DROPS = 4  # times that loops are dropped after one change, at most


@dataclass(frozen=True)
class TrustConfig:
    """When loops agree; chi-squares of 6 degrees of freedom."""

    reach: float = 30.0  # metres of way within which two loops are of one stretch
    agreement_chi2: float = 22.5  # 99.9 %: two loops of one stretch further apart contradict each other
    inlier_chi2: float = 22.5  # 99.9 %: a loop further from the map, in its own sigmas, is not in agreement
    surprise_chi2: float = 34.0  # 99.999 %: a loop further from the map, the map's doubt included, is excluded


@dataclass(frozen=True)
class Admission:
    """What the graph said of a loop when it was offered.

    Attributes:
        passed: drift explains it.
        joined: the online map leans on it from now on.
        residual: square root of its chi-square against odometry.
        reason: in plain words.
    """

    passed: bool
    joined: bool
    residual: float
    reason: str


@dataclass(frozen=True)
class Change:
    """One line of a loop's life online.

    Attributes:
        frame: the newest one at that moment.
        loop: number of the loop, in the order in which they were added.
        joined: the map leans on it from now on; False where it waits or has been taken out.
        reason: in plain words.
    """

    frame: int
    loop: int
    joined: bool
    reason: str


@dataclass(frozen=True)
class _Known:
    """A loop that passed the gate: between frames, and between their keys."""

    loop: LoopClosure
    tied: LoopClosure


class LoopTrust:
    """Takes loops one by one and keeps the map on those that agree."""

    def __init__(self, chain: OdometryChain, keys: KeyChain, map_: IncrementalMap, config: TrustConfig) -> None:
        self._chain, self._keys, self._map, self._config = chain, keys, map_, config
        self._known: dict[int, _Known] = {}
        self._group: dict[int, int] = {}  # loop to the first loop that it agrees with, directly or through others
        self._tried: dict[int, int] = {}  # group to its size when it was last tried
        self.history: list[Change] = []

    def offer(self, number: int, loop: LoopClosure, gate: LoopGate) -> Admission:
        """Take a loop in, or let it wait.

        Args:
            number: of the loop.
            loop: with the covariance that the graph believes.
            gate: the verdict on the loop alone.
        """
        reason = self._judge(number, loop) if gate.passed else gate.reason
        joined = number in self._map.used
        self._note([number], joined, reason)
        return Admission(gate.passed, joined, gate.residual, reason)

    def _judge(self, number: int, loop: LoopClosure) -> str:
        tied = self._keys.tied(loop)
        if tied is None:
            return "waits: both frames hang on one key frame, so there is nothing to correct"
        self._known[number] = _Known(loop, tied)
        self._map.know(number, tied)
        chi2 = float(self._map.chi2([number])[0])
        if self._map.used and chi2 <= self._config.inlier_chi2:
            self._take_in([number])
            return f"joined: the map agrees, {np.sqrt(chi2):.1f} sigma"
        companions = self._companions(number, loop)
        if not companions:
            return "waits: drift explains it, but no other loop of this stretch agrees yet"
        return self._with_company(number, companions)

    def _with_company(self, number: int, companions: list[int]) -> str:
        known = self._known[number]
        surprise = self._surprise(known) if self._map.used else 0.0
        if surprise > self._config.surprise_chi2:
            return self._challenge(number, companions, surprise)
        self._take_in([number, *(other for other in companions if other not in self._map.used)])
        return f"joined: {len(companions)} loops of this stretch agree, {np.sqrt(surprise):.1f} sigma from the map"

    def _challenge(self, number: int, companions: list[int], surprise: float) -> str:
        """Try a group that the map excludes against the loops that the map leans on."""
        told = f"{np.sqrt(surprise):.1f} sigma from the map (limit {np.sqrt(self._config.surprise_chi2):.1f})"
        group = self._group.get(companions[0], companions[0])
        self._group |= dict.fromkeys([number, *companions], group)
        waiting = [k for k, of in self._group.items() if of == group and k not in self._map.used]
        if len(waiting) < 2 * self._tried.get(group, 1):
            return f"waits: {told}"
        self._tried[group] = len(waiting)
        before = self._map.used
        self._take_in(waiting)
        if len(self._map.used) > len(before):
            return f"joined: {told}, but {len(waiting)} loops agree with it and outnumber those against them"
        self._restore(before)
        return f"waits: {told}, and the {len(waiting)} loops that agree with it do not outnumber those against them"

    def _restore(self, before: Iterable[int]) -> None:
        wrong = set(self._map.used) - set(before)
        self._map.drop(sorted(wrong))
        self._map.use({k: self._known[k].tied for k in sorted(set(before) - set(self._map.used))})
        self._map.settle()

    def _take_in(self, numbers: list[int]) -> None:
        """Lean on further loops; drop those that then disagree, take in others that now agree."""
        self._map.use({k: self._known[k].tied for k in numbers})
        self._map.settle()
        for _ in range(_DROPS):
            wrong = self._disagreeing()
            if not wrong:
                break
            self._map.drop(wrong)
            self._map.settle()
            self._note(wrong, False, "taken out: the map that most loops agree on contradicts it")
        self._welcome()

    def _disagreeing(self) -> list[int]:
        """Loops in use that are too far from the map, the worst only: others may agree once they are gone."""
        used = self._map.used
        if len(used) == 1:
            return list(used)  # the last one left has lost its companions
        chi2 = self._map.chi2(used)
        limit = max(self._config.inlier_chi2, 0.5 * float(chi2.max(initial=0.0)))
        return [used[k] for k in np.flatnonzero(chi2 > limit)]

    def _welcome(self) -> None:
        """Take in waiting loops that the map agrees with by now."""
        used = self._map.used
        waiting = [k for k in self._known if k not in used]
        if not used or not waiting:
            return
        chi2 = self._map.chi2(waiting)
        agree = [k for k, value in zip(waiting, chi2, strict=True) if value <= self._config.inlier_chi2]
        if agree:
            self._map.use({k: self._known[k].tied for k in agree})
            self._map.settle()
            self._note(agree, True, "joined: the map agrees by now")

    def _surprise(self, known: _Known) -> float:
        """Chi-square against the map; the drift that lasts is counted since the last frame that a loop holds."""
        held = [self._known[k].loop.query for k in self._map.used]
        last = max((frame for frame in held if frame <= known.loop.query), default=0)
        return self._map.surprise(known.tied, self._chain.lasting(last, known.loop.query))

    def _companions(self, number: int, loop: LoopClosure) -> list[int]:
        """Earlier loops of the same stretch that agree with this one, the latest first."""
        near = [k for k, known in self._known.items() if k != number and self._of_one_stretch(known.loop, loop)]
        asked = near[: -_COMPANIONS - 1 : -1]
        return [k for k in asked if self._disagreement(self._known[k].loop, loop) <= self._config.agreement_chi2]

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

    def _note(self, numbers: Iterable[int], joined: bool, reason: str) -> None:
        self.history += [Change(len(self._chain) - 1, number, joined, reason) for number in numbers]
