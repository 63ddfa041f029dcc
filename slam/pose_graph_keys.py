"""Key frames: the frames that the online graph optimises; every other frame hangs rigidly on the key before it.

A loop between two frames is moved to their keys along odometry, whose error over the short way is added to
the loop's own. Fewer nodes make each loop several times cheaper and change the map by less than its noise.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from slam.loop_closing import LoopClosure

Array = NDArray[np.float64]


@dataclass(frozen=True)
class KeySpacing:
    """When a frame becomes a key: after so much way or turning since the last one."""

    way: float = 2.5  # metres
    angle: float = 0.5  # radians


@dataclass(frozen=True)
class Hung:
    """A frame on its key.

    Attributes:
        key: number of the key, counted from 0.
        T_key_frame: (4, 4), metres; the identity for the key itself.
        covariance: (6, 6) of its right perturbation, rotation first; zero for the key itself.
    """

    key: int
    T_key_frame: Array
    covariance: Array


class KeyChain:
    """Frames as they come, each on its key; frame 0 is key 0."""

    def __init__(self, spacing: KeySpacing) -> None:
        self._spacing = spacing
        self._hung = [_as_key(0)]
        self._way = self._angle = 0.0

    def append(self, T_previous_current: Array, covariance: Array) -> Hung | None:
        """Hang the next frame by its motion (4, 4) and covariance (6, 6).

        Returns:
            Where the frame lies on the key before it if it has become a key itself, else None.
        """
        before = self._hung[-1]
        moved = Hung(
            before.key,
            before.T_key_frame @ T_previous_current,
            se3.compose_covariance(before.covariance, T_previous_current, covariance),
        )
        self._way += float(np.linalg.norm(T_previous_current[:3, 3]))
        # the chord of the turn: its angle as long as it is small
        self._angle += float(np.linalg.norm(T_previous_current[:3, :3] - np.eye(3))) / np.sqrt(2.0)
        if self._way < self._spacing.way and self._angle < self._spacing.angle:
            self._hung.append(moved)
            return None
        self._hung.append(_as_key(before.key + 1))
        self._way = self._angle = 0.0
        return moved

    def __getitem__(self, frame: int) -> Hung:
        return self._hung[frame]

    def poses(self, T_world_keys: Array) -> Array:
        """T_world_camera (N, 4, 4) of all frames on keys (K, 4, 4)."""
        keys = [hung.key for hung in self._hung]
        return T_world_keys[keys] @ np.array([hung.T_key_frame for hung in self._hung])

    def tied(self, closure: LoopClosure) -> LoopClosure | None:
        """Move a loop between frames to their keys; None where both hang on one key."""
        match, query = self._hung[closure.match], self._hung[closure.query]
        if match.key == query.key:
            return None
        T_query_key, Ad = se3.inverse(query.T_key_frame), se3.adjoint(query.T_key_frame)
        T_match_key = closure.T_match_query @ T_query_key
        own = se3.compose_covariance(closure.covariance, T_query_key, Ad @ query.covariance @ Ad.T)
        return replace(
            closure,
            query=query.key,
            match=match.key,
            T_match_query=match.T_key_frame @ T_match_key,
            covariance=se3.compose_covariance(match.covariance, T_match_key, own),
        )


def _as_key(number: int) -> Hung:
    return Hung(number, np.eye(4), np.zeros((6, 6)))
