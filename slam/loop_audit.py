"""Which of several groups of loops contradicts the others: each in turn is left out and compared with what they say.

A false group that odometry's drift can absorb lies close to the map that it has bent itself, however many true
loops there are; only the map without it tells.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

_SPOKESMEN = 6  # loops of a group that speak for it, evenly spread: neighbours say the same
_ALIKE = 0.5  # groups at so much of the largest surprise or more are equally suspect; 0.8 loses to many false ones

Surprise = Callable[[int, Sequence[int]], float]
"""Chi-square of a loop against the map that other loops make; by their numbers."""


class Audit:
    """Finds the groups to leave out, the worst first, until the rest agree; a step at a time.

    Attributes:
        left_out: group to its chi-square against the others.
    """

    def __init__(self, groups: Mapping[int, Sequence[int]], surprise: Surprise, limit: float) -> None:
        """Begin with groups of loops, and the chi-square at which one contradicts the others."""
        self._groups, self._surprise, self._limit = dict(groups), surprise, limit
        self._due = self._suspects()
        self._found: dict[int, float] = {}
        self.left_out: dict[int, float] = {}

    def step(self) -> bool:
        """Compare one group with the others; whether the audit is over."""
        if self._due:
            group = self._due.pop()
            others = [k for other, members in self._groups.items() if other != group for k in _spokesmen(members)]
            members = self._groups[group]
            self._found[group] = self._surprise(members[len(members) // 2], others)
        return not self._due and not self._worst_goes()

    def _suspects(self) -> list[int]:
        """Groups to compare; one of a single loop is in the map only because it changes nothing there."""
        return [group for group, members in self._groups.items() if len(members) > 1] if len(self._groups) > 1 else []

    def _worst_goes(self) -> bool:
        """Leave out the group that contradicts the others most, if one does; whether the rest must be asked again."""
        worst = max(self._found.values(), default=0.0)
        if worst <= self._limit:
            return False
        # Where two contradict each other both are as far off: the smaller one goes. Chi-squares, hence the square.
        alike = [group for group, chi2 in self._found.items() if chi2 >= _ALIKE**2 * worst]
        out = min(alike, key=lambda group: (len(self._groups[group]), -self._found[group]))
        self.left_out[out] = self._found[out]
        del self._groups[out]
        self._found = {}
        self._due = self._suspects()
        return bool(self._due)


def _spokesmen(members: Sequence[int]) -> list[int]:
    chosen = np.linspace(0, len(members) - 1, min(len(members), _SPOKESMEN)).round()
    return [members[int(k)] for k in chosen]
