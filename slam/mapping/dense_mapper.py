"""The dense map of a run: depth of its key frames, by stereo or by a depth camera, fused submap by submap.

Within a submap the odometry is exact enough: over 20 m it drifts less than a voxel. A corrected graph moves whole
submaps, so one fusion gives the maps before and after correction, and no image is read twice.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.stereo.stereo_self_calibration import Calibration
from slam.datasets.dataset import Dataset, Frame
from slam.datasets.prefetch import ColorFrames, Recording, has_color, prefetch
from slam.keyframes import KeyFrameConfig, KeyFrameSelector
from slam.mapping.dense_stereo import DenseStereo, DepthImage
from slam.mapping.landmark_map import LandmarkMapConfig
from slam.mapping.measured_depth import MeasuredDepth
from slam.mapping.submaps import Submap, SubmapStore
from slam.mapping.tsdf import FusionConfig, TsdfVolume

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DenseMapConfig:
    """Configuration of submaps and of their fusion.

    Attributes:
        submap_frames: maximum number of key frames of a submap.
        fusion: configuration of the fusion.
    """

    submap_frames: int = 20
    fusion: FusionConfig = field(default_factory=FusionConfig)


@dataclass(frozen=True)
class OdometryTrajectory:
    """Trajectory of the odometry.

    Attributes:
        T_world_camera: poses, (F, 4, 4), metres.
        predicted: frames whose motion was extrapolated instead of measured, (F,) bool.
    """

    T_world_camera: Array
    predicted: NDArray[np.bool_]


def group_key_frames(odometry: OdometryTrajectory, key_frames: KeyFrameConfig, size: int) -> list[list[int]]:
    """Group key frames into submaps of similar length, of at most `size` frames each.

    Frames with predicted motion are left out and separate submaps: across them the odometry is not exact enough.
    """
    selector, stretches = KeyFrameSelector(key_frames), [list[int]()]
    for index, (pose, predicted) in enumerate(zip(odometry.T_world_camera, odometry.predicted, strict=True)):
        if predicted:
            stretches.append([])
        elif selector.accepts(pose):
            stretches[-1].append(index)
    cut = (np.array_split(stretch, math.ceil(len(stretch) / size)) for stretch in stretches if stretch)
    return [piece.tolist() for pieces in cut for piece in pieces]


class DenseDepth(Protocol):
    """Where the depth of a frame comes from."""

    def depth_of(self, frame: Frame) -> DepthImage:
        """Dense depth of a frame."""
        ...


class DenseMapper:
    """Fuses the depth of a recording into submaps."""

    def __init__(self, calibration: Calibration, config: DenseMapConfig | None = None, has_depth: bool = False) -> None:
        """Make a mapper.

        Args:
            calibration: of the pair, or of the depth camera.
            config: the settings.
            has_depth: whether the frames have depth images, instead of right images.
        """
        self._config = config or DenseMapConfig()
        max_depth_m = self._config.fusion.max_depth_m
        self._source: DenseDepth
        if has_depth:
            self._source = MeasuredDepth(calibration.camera, max_depth_m)
        else:
            reach = LandmarkMapConfig(max_depth_m=max_depth_m)
            self._source = DenseStereo(calibration, reach.depth_limit(calibration.camera))

    def fuse(
        self, dataset: Dataset, odometry: OdometryTrajectory, groups: Sequence[Sequence[int]], store: SubmapStore
    ) -> Iterator[int]:
        """Add one submap to the store for each group of key frames; yield the number of key frames done so far.

        Raises:
            DataError: an image cannot be read.
        """
        frames = ColorFrames(dataset) if has_color(dataset) else dataset
        chosen = prefetch(_Subset(frames, [index for group in groups for index in group]))
        done = 0
        for group in groups:
            poses = odometry.T_world_camera[list(group)]
            middle = len(group) // 2  # as anchor it is nearest to both ends
            T_anchor_camera = se3.inverse(poses[middle]) @ poses
            volume = TsdfVolume(self._config.fusion)
            for T in T_anchor_camera:
                frame = next(chosen)
                volume.integrate(self._source.depth_of(frame), T)
                done += 1
                yield done
            store.add(Submap(group[middle], np.array(group), T_anchor_camera, volume.extract_surface()))


@dataclass(frozen=True)
class _Subset:
    """Selected frames of a recording."""

    frames: Recording[Frame]
    indices: list[int]

    def __len__(self) -> int:
        return len(self.indices)

    def __getitem__(self, index: int) -> Frame:
        return self.frames[self.indices[index]]
