"""The dense map of a drive: depth of its key frames, fused submap by submap.

Within a submap odometry is trusted: over 20 m it drifts less than a voxel. A graph moves whole submaps, so one fusion
gives the map before and after correction, and no image is read twice.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.calibration import Calibration
from slam.datasets.dataset import Dataset, Frame
from slam.datasets.prefetch import prefetch
from slam.keyframes import KeyFrameConfig, KeyFrameSelector
from slam.mapping.dense_depth import DenseStereo
from slam.mapping.fusion import FusionConfig, Volume
from slam.mapping.landmarks import LandmarkMapConfig
from slam.mapping.submaps import Submap, SubmapStore

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DenseMapConfig:
    """How a drive is cut into submaps, and how these are fused.

    Attributes:
        submap_frames: key frames of one submap.
        fusion: how depth becomes a surface.
    """

    submap_frames: int = 20
    fusion: FusionConfig = field(default_factory=FusionConfig)


@dataclass(frozen=True)
class Odometry:
    """The drive as odometry knows it.

    Attributes:
        T_world_camera: (F, 4, 4) metres.
        predicted: (F,) bool, frames whose images allowed no measurement.
    """

    T_world_camera: Array
    predicted: NDArray[np.bool_]


def choose_frames(odometry: Odometry, key_frames: KeyFrameConfig, size: int) -> list[list[int]]:
    """Key frames, in submaps of like length and at most `size`; what was predicted is left out and parts submaps."""
    selector, stretches = KeyFrameSelector(key_frames), [list[int]()]
    for index, (pose, predicted) in enumerate(zip(odometry.T_world_camera, odometry.predicted, strict=True)):
        if predicted:
            stretches.append([])
        elif selector.accepts(pose):
            stretches[-1].append(index)
    cut = (np.array_split(stretch, math.ceil(len(stretch) / size)) for stretch in stretches if stretch)
    return [piece.tolist() for pieces in cut for piece in pieces]


class DenseMapper:
    """Fuses a recorded drive into a store of submaps."""

    def __init__(self, calibration: Calibration, config: DenseMapConfig | None = None) -> None:
        self._config = config or DenseMapConfig()
        reach = LandmarkMapConfig(max_depth_m=self._config.fusion.max_depth_m)
        self._stereo = DenseStereo(calibration, reach.depth_limit(calibration.camera))

    def fuse(
        self, drive: Dataset, odometry: Odometry, groups: Sequence[Sequence[int]], store: SubmapStore
    ) -> Iterator[int]:
        """Add one submap to the store for each group of key frames; yields the key frames done so far.

        Raises:
            DataError: an image cannot be read.
        """
        frames = prefetch(_Chosen(drive, [index for group in groups for index in group]))
        done = 0
        for group in groups:
            poses = odometry.T_world_camera[list(group)]
            middle = len(group) // 2  # the fewest metres to either end
            T_anchor_camera = se3.inverse(poses[middle]) @ poses
            volume = Volume(self._config.fusion)
            for T in T_anchor_camera:
                frame = next(frames)
                assert frame.right is not None
                volume.integrate(self._stereo.see(frame.left, frame.right), T)
                done += 1
                yield done
            store.add(Submap(group[middle], np.array(group), T_anchor_camera, volume.surface()))


@dataclass(frozen=True)
class _Chosen:
    """Some frames of a drive."""

    drive: Dataset
    indices: list[int]

    def __len__(self) -> int:
        return len(self.indices)

    def __getitem__(self, index: int) -> Frame:
        return self.drive[self.indices[index]]
