"""Visual odometry as the system uses it: motion and depth of frames, of a pair, a depth camera or one camera."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from odometry.camera import StereoCamera
from odometry.mono.mono_odometry import MonoOdometry
from odometry.motion import Motion
from odometry.stereo.rgbd_odometry import RgbdOdometry
from odometry.stereo.stereo_odometry import StereoOdometry
from odometry.stereo.stereo_self_calibration import Calibration
from place_recognition.evaluation.memory import count_array_bytes
from slam.datasets.dataset import Frame

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Depths = NDArray[np.float32]

# Depth from motion is used where the camera has moved by this share of the pair's baseline: it is then about as
# accurate as depth from the pair.
_MIN_BASELINE_SHARE = 0.5
# It is also used where the parallax is this large, so that the depth is known to a quarter of itself, however near the
# scene is: loops measure what noise these depths have. A camera in a hand moves by centimetres.
_MIN_PARALLAX_PX = 2.0


class StereoVisualOdometry:
    """Odometry of a stereo pair (a VisualOdometry)."""

    has_metric_scale = True

    def __init__(self, odometry: StereoOdometry) -> None:
        self._odometry = odometry

    @property
    def calibration(self) -> Calibration:
        """Calibration error of the pair as estimated so far."""
        return self._odometry.calibration

    def track(self, frame: Frame) -> Motion:
        """Motion since the previous pair."""
        assert frame.right is not None  # a run refuses datasets without right images
        return self._odometry.track(frame.left, frame.right, frame.timestamp, frame.usable_pixels)

    def disparity(self, left: Image, right: Image | None, pixels: Array) -> Array:
        """Disparity (N,) by matching left and right."""
        assert right is not None
        return self._odometry.disparity(left, right, pixels)

    def array_bytes(self) -> int:
        """Memory of all arrays held, bytes."""
        return count_array_bytes(self._odometry)

    def state(self) -> dict[str, Any]:
        """State of the odometry."""
        return self._odometry.state()

    def restore(self, state: dict[str, Any]) -> None:
        """Restore the odometry."""
        self._odometry.restore(state)


class RgbdVisualOdometry(StereoVisualOdometry):
    """Odometry of a depth camera, whose depth image takes the place of the right image (a VisualOdometry)."""

    def __init__(self, odometry: RgbdOdometry) -> None:
        super().__init__(odometry)
        self._depth: Depths | None = None  # of the frame that was tracked last

    def track(self, frame: Frame) -> Motion:
        """Motion since the previous frame."""
        depth = frame.depth
        if depth is None:  # a recording may lack single depth images
            depth = np.full(frame.left.shape, np.nan, np.float32)
        self._depth = depth
        return self._odometry.track(frame.left, depth, frame.timestamp, frame.usable_pixels)

    def disparity(self, left: Image, right: Image | None, pixels: Array) -> Array:
        """Disparity (N,) as the depth image of the frame tracked last has it."""
        assert self._depth is not None
        return self._odometry.disparity(left, self._depth, pixels)


class MonocularVisualOdometry:
    """Odometry of one camera; earlier images of it take the place of the right image (a VisualOdometry).

    Depths are given as the disparities that a pair of the camera's baseline would show, in the unit of the map.
    """

    has_metric_scale = False
    calibration = None

    def __init__(self, odometry: MonoOdometry, camera: StereoCamera) -> None:
        self._odometry, self._camera = odometry, camera

    def track(self, frame: Frame) -> Motion:
        """Motion since the previous left image."""
        return self._odometry.track(frame.left, frame.timestamp, frame.usable_pixels)

    def disparity(self, left: Image, right: Image | None, pixels: Array) -> Array:
        """Disparity (N,) by depth from motion, where that is about as accurate as a pair's or its parallax is large."""
        depths, camera = self._odometry.depths(left, pixels), self._camera
        parallax_px = camera.fx * depths.baseline * depths.inverse
        accurate = (depths.baseline >= _MIN_BASELINE_SHARE * camera.baseline) | (parallax_px >= _MIN_PARALLAX_PX)
        return np.where(accurate, camera.fx * camera.baseline * depths.inverse, np.nan)

    def array_bytes(self) -> int:
        """Memory of all arrays held, bytes."""
        return count_array_bytes(self._odometry)

    def state(self) -> dict[str, Any]:
        """State of the odometry."""
        return self._odometry.state()

    def restore(self, state: dict[str, Any]) -> None:
        """Restore the odometry."""
        self._odometry.restore(state)
