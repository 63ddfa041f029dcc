"""The sparse map: landmarks kept in the frame that saw them, so that a corrected graph moves them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from odometry.camera import StereoCamera
from slam.record import PointCloud

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LandmarkMapConfig:
    """Which points are sure enough for the map.

    Attributes:
        max_depth_m: points farther than this are dropped, metres.
        disparity_sigma_px: standard deviation of a disparity, pixels; stereo depth has z^2 / (f b) times
            this.
        max_relative_sigma: points whose depth is less sure than this fraction of itself are dropped. With
            KITTI's baseline 5 % ends at 38 m; a shorter baseline sees less far.
    """

    max_depth_m: float = 40.0
    disparity_sigma_px: float = 0.5
    max_relative_sigma: float = 0.05

    def depth_limit(self, camera: StereoCamera | None) -> float:
        """Depth, metres, up to which points are kept; without a stereo camera `max_depth_m` alone decides."""
        if camera is None:
            return self.max_depth_m
        sure = self.max_relative_sigma * camera.fx * camera.baseline / self.disparity_sigma_px
        return min(self.max_depth_m, sure)


class LandmarkMap:
    """Points in the camera frames that saw them. Nothing stored is ever rewritten."""

    def __init__(self, config: LandmarkMapConfig | None = None, camera: StereoCamera | None = None) -> None:
        self._depth_limit = (config or LandmarkMapConfig()).depth_limit(camera)
        self._frames: list[int] = []
        self._points: list[NDArray[np.float32]] = []  # 4e-6 m at 40 m: far below what stereo can tell
        self._grey: list[NDArray[np.uint8]] = []

    def __len__(self) -> int:
        return sum(map(len, self._points))

    def add(self, frame_index: int, points_camera: Array, grey: NDArray[np.uint8]) -> None:
        """Add what one frame saw.

        Args:
            frame_index: of the frame, from 0.
            points_camera: (N, 3) metres, camera frame; NaN, points behind the camera and unsure ones are
                dropped.
            grey: (N,) brightness in the image.
        """
        depth = points_camera[:, 2]
        keep = np.isfinite(points_camera).all(axis=1) & (depth > 0) & (depth <= self._depth_limit)
        self._frames.append(frame_index)
        self._points.append(points_camera[keep].astype(np.float32))
        self._grey.append(np.asarray(grey, dtype=np.uint8)[keep])

    @property
    def frames(self) -> NDArray[np.int32]:
        """Which frame (M,) saw each point, in the order of `cloud`."""
        return np.repeat(np.array(self._frames, np.int32), [len(points) for points in self._points])

    def cloud(self, T_world_camera: Array) -> PointCloud:
        """The map on a trajectory.

        Args:
            T_world_camera: (F, 4, 4) metres, poses of all frames, before or after correction.

        Raises:
            ValueError: a frame that saw points has no pose.
        """
        if not self._frames:
            return PointCloud(np.zeros((0, 3)), np.zeros(0, dtype=np.uint8))
        if max(self._frames) >= len(T_world_camera):
            raise ValueError(f"expected poses for {max(self._frames) + 1} frames, got {len(T_world_camera)}")
        poses = T_world_camera[self.frames]
        points = np.einsum("nij,nj->ni", poses[:, :3, :3], np.concatenate(self._points)) + poses[:, :3, 3]
        return PointCloud(points, np.concatenate(self._grey))
