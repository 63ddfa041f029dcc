"""What is recorded of a frame and of the loops found with it: enough to restore a run without its images."""

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
    """What is recorded of one frame.

    Attributes:
        image: number of the image; in a map database counted through all sessions.
        timestamp: seconds.
        motion: motion since the previous frame; the tracks are counted, their pixels are not recorded.
        T_world_odometry: (4, 4) pose by odometry alone.
        T_world_online: (4, 4) online estimate at the moment when the frame was processed.
        landmarks: features with depth, in the camera's frame.
        is_key_frame: True where the landmarks joined the map.
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
    """What is recorded of one belief of the recogniser and of its geometric verification.

    Attributes:
        at_image: number of the image with which the belief came; None where it came at the end of the session.
        belief: answer of the recogniser.
        geometry: relative pose, or why there is none; None for a belief that was not accepted.
    """

    at_image: int | None
    belief: Belief
    geometry: LoopVerification
