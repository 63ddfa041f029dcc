"""Which frames the map needs: key frames moved or turned enough since the last one; known places need no more frames.

Without the second rule a map grows with the drive, also where the camera goes round the same block all day
(docs/decisions/known_places.md).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odometry import se3

Array = NDArray[np.float64]


@dataclass(frozen=True)
class KeyFrameConfig:
    """When a frame becomes a key frame.

    Attributes:
        min_distance_m: distance from the last key frame after which a frame becomes one, metres.
        min_angle_deg: angle to the last key frame after which a frame becomes one, degrees.
        max_revisits: number of frames of later visits that the map keeps of the place of each frame. Of those that come
            after them it keeps pose and loop, and a few landmarks for `revisit reprocess`.
    """

    min_distance_m: float = 1.0
    min_angle_deg: float = 10.0
    max_revisits: int = 1


class KeyFrameSelector:
    """Accepts the first frame and every frame that moved or turned enough since the last one accepted."""

    def __init__(self, config: KeyFrameConfig | None = None) -> None:
        self.config = config or KeyFrameConfig()
        self._last: Array | None = None

    def accepts(self, T_world_camera: Array) -> bool:
        """Whether a frame with pose (4, 4), metres, becomes a key frame; the next frames are then compared with it."""
        if self._last is not None and not self._is_far(se3.inverse(self._last) @ T_world_camera):
            return False
        self._last = T_world_camera.copy()
        return True

    def _is_far(self, T_last_camera: Array) -> bool:
        moved = float(np.linalg.norm(T_last_camera[:3, 3]))
        turned = float(np.degrees(se3.angle(T_last_camera)))
        return moved >= self.config.min_distance_m or turned >= self.config.min_angle_deg

    def state(self) -> dict[str, Any]:
        """Pose of the last key frame, for a checkpoint."""
        return {"T_world_key_frame": self._last}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state that `state` returned."""
        self._last = state["T_world_key_frame"]


class RevisitCounter:
    """Counts the frames that the map has of each place, as loops tell of them."""

    def __init__(self, max_revisits: int) -> None:
        self._max_revisits = max_revisits
        self._first_seen: dict[int, int] = {}  # frame that saw the place of a matched frame first
        self._revisits: dict[int, int] = {}  # frames of later visits, by the frame that saw their place first

    def add(self, query: int, match: int) -> bool:
        """Add a loop of a frame to an earlier one; return whether the map has enough frames of their place."""
        first = self._first_seen.get(match, match)
        count = self._revisits.get(first, 0)
        if count >= self._max_revisits:
            return True
        self._first_seen[query], self._revisits[first] = first, count + 1
        return False
