"""How the system moves and sees depth: with the two eyes of a stereo pair, or with one."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from odometry.camera import StereoCamera
from odometry.mono import MonoOdometry
from odometry.motion import Motion
from odometry.stereo import StereoOdometry
from slam.datasets.dataset import Frame

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_AS_SURE = 0.5  # share of the pair's baseline that one moving eye must have had for its depths to be as sure, about


class Eyes(Protocol):
    """Answers how the camera moved since the previous frame, and how far away what it shows is."""

    @property
    def odometry(self) -> StereoOdometry | MonoOdometry | None:
        """What does the work; None where it has been done before."""
        ...

    def track(self, frame: Frame) -> Motion:
        """Motion since the previous frame; always finite."""
        ...

    def disparity(self, left: Image, right: Image | None, pixels: Array) -> Array:
        """Disparity (N,), pixels, of the stereo camera at pixels (N, 2) of the frame tracked last; NaN: not known."""
        ...


class TwoEyes:
    """A stereo pair."""

    def __init__(self, odometry: StereoOdometry) -> None:
        self.odometry = odometry

    def track(self, frame: Frame) -> Motion:
        """Motion since the previous pair."""
        assert frame.right is not None  # the run has refused drives without right images
        return self.odometry.track(frame.left, frame.right, frame.timestamp)

    def disparity(self, left: Image, right: Image | None, pixels: Array) -> Array:
        """Disparity (N,) by matching left and right."""
        assert right is not None
        return self.odometry.disparity(left, right, pixels)


class OneEye:
    """One camera; what it has seen while moving takes the place of the right image.

    Depths are given as the disparities that a pair of the camera's baseline would show, in the unit of the map.
    """

    def __init__(self, odometry: MonoOdometry, camera: StereoCamera) -> None:
        self.odometry, self._camera = odometry, camera

    def track(self, frame: Frame) -> Motion:
        """Motion since the previous left image."""
        return self.odometry.track(frame.left, frame.timestamp)

    def disparity(self, left: Image, right: Image | None, pixels: Array) -> Array:
        """Disparity (N,) by depth from motion, where that is about as sure as a pair's."""
        depths, camera = self.odometry.depths(left, pixels), self._camera
        sure = depths.baseline >= _AS_SURE * camera.baseline
        return np.where(sure, camera.fx * camera.baseline * depths.inverse, np.nan)
