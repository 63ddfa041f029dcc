"""Which of several groups of loops contradicts the others: each in turn is left out and compared with what they say.

A false group that odometry's drift can absorb lies close to the map that it has bent itself, however many true
loops there are; only the map without it tells.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from slam.loop_closing import LoopClosure
from slam.pose_graph_online import BatchMap, IncrementalMap

Array = NDArray[np.float64]
Drift = Callable[[int, Sequence[int]], Array]
"""Covariance (6, 6) of a loop that the map of others knows nothing of: its number, and theirs."""

_STEPS = 3  # of Gauss and Newton for each map; measured: more change no verdict
_ALIKE = 0.8  # groups at so much of the largest surprise or more are equally suspect


class Audit:
    """Finds the groups to leave out, the worst first, until the rest agree; a step at a time."""

    def __init__(
        self, map_: IncrementalMap, loops: Mapping[int, LoopClosure], groups: Mapping[int, Sequence[int]], drift: Drift
    ) -> None:
        self._map, self._loops, self._drift = map_, loops, drift
        self._groups = dict(groups)
        self._due = [group for group, members in groups.items() if len(members) > 1]
        self._surprises: dict[int, float] = {}
        self._trial: BatchMap | None = None
        self._steps = 0
        self.left_out: dict[int, float] = {}  # group to its chi-square against the others

    def step(self, limit: float) -> bool:
        """Go one step on.

        Args:
            limit: chi-square against the others at which a group contradicts them.

        Returns:
            Whether the audit is over.
        """
        if self._due:
            self._examine(self._due[-1])
        return not self._due and not self._worst_goes(limit)

    def _examine(self, group: int) -> None:
        others = [k for other, members in self._groups.items() if other != group for k in members]
        if self._trial is None:
            self._trial, self._steps = self._map.leaning_on(self._loops[k] for k in others), 0
        if self._steps < _STEPS:
            self._trial.step()
            self._steps += 1
            return
        members = self._groups[group]
        middle = members[len(members) // 2]
        self._surprises[group] = self._trial.surprise(self._loops[middle], self._drift(middle, others))
        self._due.pop()
        self._trial = None

    def _worst_goes(self, limit: float) -> bool:
        """Leave out the group that contradicts the others most, if one does, and ask the rest again."""
        worst = max(self._surprises.values(), default=0.0)
        if worst <= limit:
            return False
        # Chi-squares, hence the square; where two contradict each other the smaller one is left out.
        suspects = [group for group, chi2 in self._surprises.items() if chi2 >= _ALIKE**2 * worst]
        out = min(suspects, key=lambda group: (len(self._groups[group]), -self._surprises[group]))
        self.left_out[out] = self._surprises[out]
        del self._groups[out]
        self._surprises = {}
        self._due = [group for group, members in self._groups.items() if len(members) > 1]
        return len(self._groups) > 1
