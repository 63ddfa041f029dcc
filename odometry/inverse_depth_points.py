"""Inverse-depth points of a window of frames, each on the ray of its anchor: the frame that saw it first."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.camera import clamp_inverse_depth
from odometry.distortion import LensDistortion

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

_DEFAULT_INVERSE_DEPTH = 1.0 / 15.0  # while nothing is known; the unit of a map is at first such that this is so
_MAX_DEPTH_SIGMA = 0.3  # largest standard deviation of a depth that is known, as a share of it
_FIELDS = ("ids", "frame", "anchor_pixel", "inverse_depth", "information")  # of `Points`


@dataclass(frozen=True)
class FrameObservations:
    """Points that one image of one camera shows.

    Attributes:
        ids: (N,) growing numbers of the tracks.
        pixels: (N, 2).
    """

    ids: Indices
    pixels: Array


@dataclass(frozen=True)
class ObservationTable:
    """All observations in a window, sorted by point and then by frame.

    Attributes:
        ids: (N,) numbers of the points, growing.
        first: (N + 1,) first observation of each point, and the end of the last one's.
        frame: (M,) frame of each observation.
        pixels: (M, 2) pixels.
    """

    ids: Indices
    first: Indices
    frame: Indices
    pixels: Array

    @classmethod
    def from_frames(cls, frames: list[FrameObservations]) -> "ObservationTable":
        """Sort the observations of all frames by point."""
        ids = np.concatenate([seen.ids for seen in frames])
        frame = np.repeat(np.arange(len(frames)), [len(seen.ids) for seen in frames])
        order = np.argsort(ids, kind="stable")  # stable: each point's observations stay in the order of frames
        names, counts = np.unique(ids, return_counts=True)
        places = np.concatenate([seen.pixels for seen in frames])
        return cls(names, np.concatenate([[0], np.cumsum(counts)]), frame[order], places[order])

    @property
    def anchor(self) -> Indices:
        """(N,) the frame that saw each point first."""
        return self.frame[self.first[:-1]]

    @property
    def counts(self) -> Indices:
        """(N,) frames that saw each point."""
        return np.diff(self.first)

    def is_followed(self) -> Mask:
        """Which of the observations (M,) are not a point's first."""
        followed = np.ones(len(self.frame), dtype=bool)
        followed[self.first[:-1]] = False
        return followed


@dataclass(frozen=True)
class Points:
    """Points with inverse depths.

    Attributes:
        ids: (N,) numbers, growing.
        frame: (N,) frame of the window that each is anchored in.
        anchor_pixel: (N, 2) adjusted place of the point in its anchor's image, pixels.
        inverse_depth: (N,) in that frame.
        information: (N,) about the inverse depth, pixels squared over its unit squared; 0 where nothing is known.
    """

    ids: Indices
    frame: Indices
    anchor_pixel: Array
    inverse_depth: Array
    information: Array

    @classmethod
    def empty(cls) -> "Points":
        """No points."""
        empty = np.zeros(0)
        return cls(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 2)), empty, empty)

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def median_inverse_depth(self) -> float:
        """Median inverse depth of the points that have one."""
        known = self.information > 0
        return float(np.median(self.inverse_depth[known])) if known.any() else _DEFAULT_INVERSE_DEPTH

    def is_sure(self, noise_px: float) -> Mask:
        """Which of the points (N,) have a depth that is known well enough to carry the scale on."""
        return self.information * (_MAX_DEPTH_SIGMA * self.inverse_depth) ** 2 > noise_px**2

    def select(self, ids: Indices) -> "Points":
        """Points of these numbers (M,), in this order; unknown ones have no information and the median depth."""
        index = np.searchsorted(self.ids, ids).clip(0, max(len(self) - 1, 0))
        if not len(self):
            nothing = np.zeros(len(ids))
            return Points(ids, np.zeros_like(ids), np.zeros((len(ids), 2)), nothing + _DEFAULT_INVERSE_DEPTH, nothing)
        known = self.ids[index] == ids
        return Points(
            ids, self.frame[index], self.anchor_pixel[index],
            np.where(known, self.inverse_depth[index], self.median_inverse_depth),
            np.where(known, self.information[index], 0.0),
        )  # fmt: skip

    def merge(self, other: "Points") -> "Points":
        """These points and others, which take the place of any of the same number."""
        kept = ~np.isin(self.ids, other.ids)
        order = np.argsort(np.concatenate([self.ids[kept], other.ids]), kind="stable")
        return Points(*(np.concatenate([getattr(self, name)[kept], getattr(other, name)])[order] for name in _FIELDS))

    def rescale(self, factor: float) -> "Points":
        """Make the map larger by a factor."""
        return replace(self, inverse_depth=self.inverse_depth / factor, information=self.information * factor**2)

    def reanchor(
        self, observations: ObservationTable, poses: Array, lens: LensDistortion, leaving: int = 0
    ) -> "Points":
        """Anchor points in the frames that see them first now.

        Args:
            observations: observations without those of the frame that leaves.
            poses: (K, 4, 4) T_map_frame, the frame that leaves included.
            lens: of the camera.
            leaving: the frame that leaves; those after it are counted from one less.
        """
        old = self.select(observations.ids)
        anchor = observations.anchor + (observations.anchor >= leaving)
        T = se3.inverse(poses[anchor]) @ poses[old.frame]
        ray = lens.rays(old.anchor_pixel)
        seen = np.einsum("nij,nj->ni", T[:, :3, :3], ray) + T[:, :3, 3] * old.inverse_depth[:, None]
        z = np.maximum(seen[:, 2], 1e-3)
        moved = anchor != old.frame
        place = np.where(moved[:, None], lens.pixels(np.column_stack([seen[:, :2], z])), old.anchor_pixel)
        depth = np.where(moved, clamp_inverse_depth(old.inverse_depth / z), old.inverse_depth)
        return Points(observations.ids, observations.anchor, place, depth, old.information)


def clamp_points(state: Array) -> Array:
    """Clamp the inverse depths of points (N, 3), two pixels and an inverse depth, to what a camera can see."""
    return np.column_stack([state[:, :2], clamp_inverse_depth(state[:, 2])])
