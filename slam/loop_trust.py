"""Which loops the map leans on while driving: none by itself, and none against the others.

A loop that drift can explain may still be false, and nothing at that moment tells. So it waits until a second
one of the same stretch agrees with it (pairwise consistency: Mangelson et al., ICRA 2018, equation 3). With
such a companion it must be one that the map, as sure as it is, does not exclude. Whenever a group of loops has
doubled, each is compared with what the others say (`loop_audit`): those in the map, and one that the map excludes.
"""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from slam.loop_audit import Audit
from slam.loop_closing import LoopClosure
from slam.loop_groups import GroupConfig, LoopGroups
from slam.pose_graph_drift import OdometryChain
from slam.pose_graph_keys import KeyChain
from slam.pose_graph_online import IncrementalMap
from slam.robust import LoopGate

Array = NDArray[np.float64]

_DROPS = 3  # times that a loop may come and go; without an end two that exclude each other would take turns


@dataclass(frozen=True)
class TrustConfig:
    """When the map leans on a loop; chi-squares of 6 degrees of freedom."""

    inlier_chi2: float = 22.5  # 99.9 %: a loop further from the map, in its own sigmas, is not in agreement
    surprise_chi2: float = 34.0  # 99.999 %: a loop further from the map, the map's doubt included, is excluded
    groups: GroupConfig = field(default_factory=GroupConfig)


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


class LoopTrust:
    """Takes loops one by one and keeps the map on those that agree."""

    def __init__(self, chain: OdometryChain, keys: KeyChain, map_: IncrementalMap, config: TrustConfig) -> None:
        self._chain, self._keys, self._map, self._config = chain, keys, map_, config
        self._groups = LoopGroups(chain, config.groups)
        self._audited: dict[int, int] = {}  # group to its size when it was last audited
        self._audit: Audit | None = None
        self._candidate: int | None = None  # group outside the map that the audit is about
        self._dropped: Counter[int] = Counter()  # how often the map has contradicted each loop
        self._due = False
        self._excluded: list[int] = []  # groups to reconsider, as the map has changed
        self._moving = False
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
        if joined:
            self.review()
        return Admission(gate.passed, joined, gate.residual, reason)

    def review(self) -> None:
        """Go one step on with what the last loop has set in motion, or with an audit, if there is one.

        A step a frame, so that no frame waits for a large correction to settle. Loops are judged by a map at
        rest only.
        """
        if self._moving:
            if self._map.step():
                self._moving = self._drop() or self._welcome()
        elif self._audit is not None:
            if self._audit.step():
                self._conclude(self._audit)
        elif self._due:
            self._due = False
            self._begin(None)
        elif self._excluded:
            self._reconsider(self._excluded.pop())

    def _judge(self, number: int, loop: LoopClosure) -> str:
        tied = self._keys.tied(loop)
        if tied is None:
            return "waits: both frames hang on one key frame, so there is nothing to correct"
        companions = self._groups.add(number, loop, tied)
        self._map.know(number, tied)
        chi2 = float(self._map.chi2([number])[0])
        if self._map.used and chi2 <= self._config.inlier_chi2:
            self._use([number])
            return f"joined: the map agrees, {np.sqrt(chi2):.1f} sigma"
        if not companions:
            return "waits: drift explains it, but no other loop of this stretch agrees yet"
        return self._with_company(number, companions)

    def _with_company(self, number: int, companions: list[int]) -> str:
        used = self._map.used
        surprise = self._surprise(number) if used else 0.0
        if surprise > self._config.surprise_chi2:
            return self._challenge(number, surprise)
        newcomers = [other for other in companions if other not in used]
        self._use([number, *newcomers])
        self._note(newcomers, True, f"joined: loop {number} of this stretch agrees")
        found = f"{len(companions)} {'loops' if len(companions) > 1 else 'loop'} of this stretch"
        return f"joined: {found} and the map agree, {np.sqrt(surprise):.1f} sigma"

    def _challenge(self, number: int, surprise: float) -> str:
        """Have a group that the map excludes compared with the groups that the map leans on."""
        told = f"waits: {np.sqrt(surprise):.1f} sigma from the map (limit {np.sqrt(self._config.surprise_chi2):.1f})"
        group = self._groups[number].group
        size = len(self._groups.members(group))
        if self._audit is not None or size < 2 * self._audited.get(group, 1):
            return told
        self._audited[group] = size
        self._begin(group)
        return f"{told}; as {size} loops agree with it, each group is compared with the others"

    def _begin(self, candidate: int | None) -> None:
        """Begin to compare the groups in use, and a candidate, with one another."""
        groups: dict[int, list[int]] = {}
        for k in self._map.used:
            groups.setdefault(self._groups[k].group, []).append(k)
        if candidate is not None:
            groups[candidate] = self._groups.members(candidate)
        self._candidate = candidate
        self._audit = Audit(groups, self._groups.by_others, self._config.surprise_chi2)

    def _conclude(self, audit: Audit) -> None:
        """Do as an audit says."""
        used, candidate = set(self._map.used), self._candidate
        self._audit = self._candidate = None
        for group, chi2 in audit.left_out.items():
            wrong = [k for k in self._groups.members(group) if k in used]
            self._map.drop(wrong)
            self._note(wrong, False, f"taken out: the other groups of loops put it {np.sqrt(chi2):.1f} sigma off")
            self._moving = self._moving or bool(wrong)
        if candidate is not None and candidate not in audit.left_out:
            members = [k for k in self._groups.members(candidate) if k not in used]
            self._use(members)
            self._note(members, True, f"joined: {len(members)} loops outweigh those against them")
        if self._moving:
            self._excluded = [group for group in self._groups.names if group != candidate]

    def _reconsider(self, group: int) -> None:
        """Take in a group that the map has excluded if it no longer does."""
        used = set(self._map.used)
        waiting = [k for k in self._groups.members(group) if k not in used]
        if len(waiting) < 2 or not used:
            return
        surprise = self._surprise(waiting[len(waiting) // 2])
        if surprise <= self._config.surprise_chi2:
            self._use(waiting)
            self._note(waiting, True, f"joined: {np.sqrt(surprise):.1f} sigma from the map by now")

    def _use(self, numbers: Iterable[int]) -> None:
        self._map.use({k: self._groups[k].tied for k in numbers})
        self._moving = True
        for group in sorted({self._groups[k].group for k in numbers}):
            size = len(self._groups.members(group))
            if size >= 2 * self._audited.get(group, 1):
                self._audited[group], self._due = size, True

    def _drop(self) -> bool:
        """Take out the loops in use that are too far from the map; whether there were any.

        Only the worst at once: the others may agree when those are gone.
        """
        used = self._map.used
        chi2 = self._map.chi2(used)
        limit = max(self._config.inlier_chi2, 0.5 * float(chi2.max(initial=0.0)))
        wrong = [used[k] for k in np.flatnonzero(chi2 > limit)]
        self._map.drop(wrong)
        self._dropped.update(wrong)
        self._note(wrong, False, f"taken out: over {np.sqrt(limit):.1f} sigma from the map that the others make")
        if len(used) - len(wrong) == 1:
            (last,) = set(used) - set(wrong)
            self._map.drop([last])
            self._note([last], False, "taken out: no other loop agrees any more")
            return True
        return bool(wrong)

    def _welcome(self) -> bool:
        """Take in the waiting loops that the map agrees with by now; whether there were any."""
        used = set(self._map.used)
        waiting = [k for k in self._groups.numbers if k not in used and self._dropped[k] < _DROPS] if used else []
        chi2 = self._map.chi2(waiting)
        agree = [k for k, value in zip(waiting, chi2, strict=True) if value <= self._config.inlier_chi2]
        if agree:
            self._use(agree)
        self._note(agree, True, "joined: the map agrees by now")
        return bool(agree)

    def _surprise(self, number: int) -> float:
        return self._map.surprise(self._groups[number].tied, self._groups.drift(number, self._map.used))

    def _note(self, numbers: Iterable[int], joined: bool, reason: str) -> None:
        self.history += [Change(len(self._chain) - 1, number, joined, reason) for number in numbers]
