"""Records of frames and loop candidates, from which a run is restored without its images."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from odometry.motion import Motion
from place_recognition.recognizer import Belief
from slam.loop_closing.loop_closer import FrameLandmarks, LoopVerification

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FrameRecord:
    """Record of one frame.

    Attributes:
        image: number of the image; in a map database counted through all sessions.
        timestamp: seconds.
        motion: motion since the previous frame, with the number of its tracks but not their pixels.
        T_world_odometry: (4, 4) pose by odometry alone.
        T_world_online: (4, 4) online estimate at the moment when the frame was processed.
        landmarks: features with depth, in the camera's frame.
        is_key_frame: whether the frame is a key frame of the map.
        stage_ms: milliseconds by stage.
        T_world_camera: (4, 4) corrected pose; None until the session has ended.
        unit: unit of length of the frame, as a multiple of that of the first frame.
    """

    image: int
    timestamp: float
    motion: Motion
    T_world_odometry: Array
    T_world_online: Array
    landmarks: FrameLandmarks
    is_key_frame: bool
    stage_ms: Mapping[str, float]
    T_world_camera: Array | None = None
    unit: float = 1.0


@dataclass(frozen=True)
class LoopRecord:
    """Record of one belief of the recogniser and of its geometric verification.

    Attributes:
        at_image: number of the image with which the belief became ready; None at the end of the session.
        belief: belief of the recogniser.
        geometry: relative pose, or why there is none; None for a belief that was not accepted.
    """

    at_image: int | None
    belief: Belief
    geometry: LoopVerification
