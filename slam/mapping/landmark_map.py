"""The sparse map: landmarks in the camera frames that observed them, so that a corrected graph moves them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from odometry.camera import StereoCamera
from slam.run_result import PointCloud

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LandmarkMapConfig:
    """Accuracy that points of the map must have.

    Attributes:
        max_depth_m: maximum depth of a point, metres.
        disparity_sigma_px: standard deviation of a disparity, pixels; that of a depth z is z^2 / (f b) times this.
        max_relative_sigma: maximum standard deviation of a depth, as a share of the depth. With KITTI's baseline
            5 % are reached at 38 m, with a shorter baseline earlier.
    """

    max_depth_m: float = 40.0
    disparity_sigma_px: float = 0.5
    max_relative_sigma: float = 0.05

    def depth_limit(self, camera: StereoCamera | None) -> float:
        """Return the maximum depth of points, metres; without a stereo camera it is `max_depth_m`."""
        if camera is None:
            return self.max_depth_m
        accurate_m = self.max_relative_sigma * camera.fx * camera.baseline / self.disparity_sigma_px
        return min(self.max_depth_m, accurate_m)


class LandmarkMap:
    """Landmarks in the camera frames that observed them; stored points never change."""

    def __init__(self, config: LandmarkMapConfig | None = None, camera: StereoCamera | None = None) -> None:
        self._depth_limit = (config or LandmarkMapConfig()).depth_limit(camera)
        self._points: dict[int, NDArray[np.float32]] = {}  # 4e-6 m at 40 m: far below what stereo can tell
        self._grey: dict[int, NDArray[np.uint8]] = {}

    def __len__(self) -> int:
        return sum(map(len, self._points.values()))

    def add(self, frame_index: int, points_camera: Array, grey: NDArray[np.uint8]) -> None:
        """Add the landmarks of one frame.

        Args:
            frame_index: index of the frame, from 0.
            points_camera: points in the camera frame, (N, 3), metres; NaN, points behind the camera and points of
                inaccurate depth are dropped.
            grey: brightness in the image, (N,).
        """
        depth = points_camera[:, 2]
        keep = np.isfinite(points_camera).all(axis=1) & (depth > 0) & (depth <= self._depth_limit)
        self._points[frame_index] = points_camera[keep].astype(np.float32)
        self._grey[frame_index] = np.asarray(grey, dtype=np.uint8)[keep]

    def remove(self, frame_index: int) -> None:
        """Remove the landmarks of a frame, if it has any."""
        self._points.pop(frame_index, None)
        self._grey.pop(frame_index, None)

    @property
    def frames(self) -> NDArray[np.int32]:
        """Index of the frame that observed each point, (M,), in the order of `cloud`."""
        return np.repeat(np.array(list(self._points), np.int32), [len(points) for points in self._points.values()])

    def cloud(self, T_world_camera: Array) -> PointCloud:
        """Return all landmarks in the world frame.

        Args:
            T_world_camera: poses of all frames, (F, 4, 4), metres, before or after correction.

        Raises:
            ValueError: a frame with landmarks has no pose.
        """
        if not self._points:
            return PointCloud(np.zeros((0, 3)), np.zeros(0, dtype=np.uint8))
        if max(self._points) >= len(T_world_camera):
            raise ValueError(f"expected poses for {max(self._points) + 1} frames, got {len(T_world_camera)}")
        poses = ((T_world_camera[frame], points) for frame, points in self._points.items())
        # Frame by frame: a pose for each of a million points would take more memory than the map.
        moved = [np.einsum("ij,nj->ni", T[:3, :3], points) + T[:3, 3] for T, points in poses]
        return PointCloud(np.concatenate(moved), np.concatenate(list(self._grey.values())))
