"""Selection of the key frames of the map: frames that moved or turned enough since the last one."""

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
    """

    min_distance_m: float = 1.0
    min_angle_deg: float = 10.0


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
