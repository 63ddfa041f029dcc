"""Bundle adjustment over the last key frames of one camera: poses, inverse depths and the lens together.

Scale is what a single camera drifts in, and what carries it on are points that live long in a long window: the
older key frames are fixed, which costs nothing but their sightings, and the newer ones are adjusted. A point that
outlives the frame that saw it first is anchored in the next one, with what was known of its depth. Depths are
eliminated point by point (Triggs et al., Bundle Adjustment, 1999, section 6). Memory is bounded by the window.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from odometry import se3
from odometry.bundle_equations import accumulate
from odometry.camera import within_sight
from odometry.lens import COEFFICIENTS, Lens, LensConfig

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

_LIMIT = 9.21  # chi squared, 99 %, two residuals of a sighting
_MEDIAN = 1.386  # its median
_NOISE_AT_FIRST = 0.5  # pixels; the largest that is assumed as well
_DAMPING = 1e-3  # information, 1/rad² and 1/m²: keeps matrices regular


@dataclass(frozen=True)
class BundleConfig:
    """How much is adjusted together.

    Attributes:
        frames: key frames in the window.
        free: of them, the newest that are adjusted; the older ones stay where they are.
        iterations: steps for each new key frame, which start from the window before.
        locating: most steps for the pose of one frame with all depths known.
        floor_px: smallest noise level of a measurement that is believed, pixels.
        memory: share of a track's error that it still has in the next key frame.
        repeats: windows in which one track is seen, so that it does not teach the lens anew in each.

    """

    frames: int = 12
    free: int = 6
    iterations: int = 2
    locating: int = 8
    floor_px: float = 0.05
    memory: float = 0.5
    repeats: float = 10.0


@dataclass(frozen=True)
class Seen:
    """The points that one key frame shows.

    Attributes:
        ids: (N,) growing names of the tracks.
        pixels: (N, 2).

    """

    ids: Indices
    pixels: Array


@dataclass(frozen=True)
class Points:
    """What is known of the points of a window, in the order of their names.

    Attributes:
        ids: (N,) names, growing.
        frame: (N,) which frame of the window saw each first.
        place: (N, 2) where, pixels.
        depth: (N,) inverse depth there.
        trust: (N,) its information, pixels squared over unit squared; 0 where nothing is known.

    """

    ids: Indices
    frame: Indices
    place: Array
    depth: Array
    trust: Array

    def find(self, ids: Indices) -> tuple[Indices, Mask]:
        """Where points are in here (M,), and which are (M,)."""
        at = np.searchsorted(self.ids, ids).clip(0, max(len(self.ids) - 1, 0))
        return at, (self.ids[at] == ids) if len(self.ids) else np.zeros(len(ids), bool)


@dataclass(frozen=True)
class Placed:
    """Where a frame was taken, with all points known.

    Attributes:
        T_window_frame: (4, 4).
        covariance: (6, 6) of the right perturbation, rotation first.
        inliers: (N,) bool.
        noise_px: standard deviation of a measurement, pixels.
        residual_px: root mean square of the inliers' residuals.

    """

    T_window_frame: Array
    covariance: Array
    inliers: Mask
    noise_px: float
    residual_px: float


class Bundle:
    """Keeps the last key frames and adjusts them."""

    def __init__(self, lens: Lens, config: BundleConfig | None = None, lens_config: LensConfig | None = None) -> None:
        self._config, self._lens_config = config or BundleConfig(), lens_config or LensConfig()
        self.lens = lens
        self._frames: list[Seen] = []
        self.poses = np.zeros((0, 4, 4))  # T_oldest_frame
        self.noise_px = _NOISE_AT_FIRST
        self.points = Points(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros(0), np.zeros(0))

    def __len__(self) -> int:
        return len(self._frames)

    def begin(self, frames: list[Seen], T_first_second: Array, iterations: int = 10) -> Mask:
        """Forget everything but two frames, the second at (4, 4) in the first; which of its points agree."""
        self._frames, self.poses = list(frames), np.stack([np.eye(4), T_first_second])
        self.points = Points(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros(0), np.zeros(0))
        return self._adjust(1, iterations)

    def add(self, seen: Seen, T_window_frame: Array) -> Mask:
        """Add a key frame about where it is said to be, (4, 4), and adjust; which of its points agree (N,)."""
        if len(self._frames) >= self._config.frames:
            self._drop_oldest()
            T_window_frame = self._shifted @ T_window_frame
        self._frames.append(seen)
        self.poses = np.concatenate([self.poses, T_window_frame[None]])
        return self._adjust(self._config.free, self._config.iterations)

    def rescale(self, factor: float) -> None:
        """Make everything larger by a factor; no image contradicts that."""
        self.poses = self.poses.copy()
        self.poses[:, :3, 3] *= factor
        p = self.points
        self.points = Points(p.ids, p.frame, p.place, p.depth / factor, p.trust * factor**2)

    def in_frame(self, ids: Indices, T_window_frame: Array) -> tuple[Array, Array]:
        """Points (N, 4) of tracks in a frame at (4, 4), each times its inverse depth where it was first seen:
        finite at infinity; unknown ones at the depth of most. And their trust (N,), 0 for unknown ones."""
        at, known = self.points.find(ids)
        p = self.points
        rays = self.lens.rays(p.place[at])
        T = se3.inverse(T_window_frame) @ self.poses[p.frame[at]]
        out = np.einsum("nij,nj->ni", T[:, :3, :3], rays) + T[:, :3, 3] * p.depth[at, None]
        return np.concatenate([out, p.depth[at, None]], axis=1), np.where(known, p.trust[at], 0.0)

    def locate(self, ids: Indices, pixels: Array, T_guess: Array) -> Placed:
        """Find the pose of a frame that shows known points at pixels (N, 2), near a guess (4, 4) of T_window_frame."""
        p, config = self.points, self._config
        at, _ = p.find(ids)
        k = len(self._frames)
        first = 2 * np.arange(len(ids) + 1)
        frame = np.stack([p.frame[at], np.full(len(ids), k)], axis=1).ravel()
        places = np.stack([p.place[at], pixels], axis=1).reshape(-1, 2)
        states = np.full(k + 1, -9, np.int64)
        states[k] = 0
        T, depth, sigma, start = T_guess, p.depth[at].copy(), 2.0, 2.0
        for i in range(config.locating):
            start = max(2.0 * 0.5**i, sigma)
            H, b, chi2, rows, offset, _ = accumulate(
                _intrinsics(self.lens), (first, frame, places), (depth, p.depth[at], p.trust[at]),
                np.concatenate([self.poses, T[None]]), states, self.lens.coefficients, _LIMIT * start**2, 0.0,
            )
            change = np.zeros(6 + COEFFICIENTS)
            change[:6] = np.linalg.solve(H[:6, :6] / start**2 + _DAMPING * np.eye(6), -b[:6] / start**2)
            depth = within_sight(depth - offset - rows @ change)
            T = T @ se3.exp(change[:6])
            known = chi2[1::2][p.trust[at] > 0]
            if len(known):
                sigma = float(np.clip(np.sqrt(np.quantile(known, 0.3) / 0.713), config.floor_px, 2.0))
            if i > 2 and np.abs(change).max() < 1e-4:
                break
        inliers = chi2[1::2] < 2 * _LIMIT * sigma**2
        covariance = np.linalg.inv(H[:6, :6] / sigma**2 + _DAMPING * np.eye(6))
        residual = float(np.sqrt(chi2[1::2][inliers].mean() / 2)) if inliers.any() else float("nan")
        return Placed(T, covariance, inliers, sigma, residual)

    def _adjust(self, free: int, iterations: int) -> Mask:
        """Gauss-Newton; changes nothing if it does not converge."""
        config, lens = self._config, self.lens
        sightings, counts, ids = _gather(self._frames)
        first, frame, places = sightings
        depth, expected, trust = self._depths(ids, sightings)
        free = min(free, len(self.poses) - 1)
        states = np.full(len(self.poses), -9, np.int64)
        states[-free:] = 6 * np.arange(free)
        poses, coefficients = self.poses, lens.coefficients
        prior = np.linalg.inv(lens.covariance)
        for i in range(iterations):
            sigma = self.noise_px
            H, b, chi2, rows, offset, curvature = accumulate(
                _intrinsics(lens), sightings, (depth, expected, trust), poses, states, coefficients,
                _LIMIT * sigma**2, config.memory,
            )
            A, g = H / sigma**2, b / sigma**2
            A[-3:, -3:] += prior
            g[-3:] += prior @ (coefficients - lens.coefficients)
            change = np.linalg.solve(A + _DAMPING * np.eye(len(g)), -g)
            depth = within_sight(depth - offset - rows @ change)
            poses = poses.copy()
            for k in np.flatnonzero(states >= 0):
                poses[k] = poses[k] @ se3.exp(change[states[k] : states[k] + 6])
            coefficients = coefficients + change[-3:]
            follow = np.ones(len(frame), bool)
            follow[first[:-1]] = False
            noise = float(np.sqrt(np.median(chi2[follow]) / _MEDIAN))
            self.noise_px = float(np.clip(noise, config.floor_px, _NOISE_AT_FIRST))
        if not (np.isfinite(poses).all() and np.isfinite(depth).all() and np.isfinite(coefficients).all()):
            return np.ones(len(self._frames[-1].ids), bool)
        x = H[:-3, :-3] / sigma**2 + _DAMPING * np.eye(len(g) - 3)
        cross = H[:-3, -3:] / sigma**2
        information = H[-3:, -3:] / sigma**2 - cross.T @ np.linalg.solve(x, cross)
        self.lens = lens.learned(coefficients, information / config.repeats, self._lens_config)
        self.poses = poses
        self.points = Points(ids, frame[first[:-1]], places[first[:-1]], depth, np.where(counts > 1, curvature, 0.0))
        newest = frame == len(self._frames) - 1
        names = np.repeat(ids, counts)[newest]
        good = chi2[newest] < 2 * _LIMIT * self.noise_px**2
        at = np.searchsorted(names, self._frames[-1].ids)
        return good[at]

    def _depths(self, ids: Indices, sightings: tuple[Indices, Indices, Array]) -> tuple[Array, Array, Array]:
        first, frame, places = sightings
        at, known = self.points.find(ids)
        if len(self.points.ids):
            known &= self.points.trust[at] > 0
            start = self.points.depth[at] if len(self.points.ids) else None
            usual = float(np.median(self.points.depth[self.points.trust > 0])) if known.any() else 0.05
        else:
            start, usual = np.full(len(ids), 0.05), 0.05
        a, z = first[:-1], first[1:] - 1
        rays, seen = self.lens.rays(places[a]), self.lens.rays(places[z])
        T = se3.inverse(self.poses[frame[z]]) @ self.poses[frame[a]]
        d, strength = triangulate(rays, seen, T)
        new = np.where(strength > 1e-8, within_sight(d), usual)
        depth = np.where(known, start, new)
        return depth, depth.copy(), np.zeros(len(ids))

    def _drop_oldest(self) -> None:
        """Forget the oldest frame: its points move to the next frame that saw them."""
        self._shifted = se3.inverse(self.poses[1])
        kept = self._shifted @ self.poses[1:]
        kept[:, :3, :3] = Rotation.from_matrix(kept[:, :3, :3]).as_matrix()
        p = self.points
        sightings, _, ids = _gather(self._frames[1:])
        first, frame, places = sightings
        a = first[:-1]
        at, known = p.find(ids)
        ray = self.lens.rays(p.place[at])
        T = se3.inverse(self.poses[frame[a] + 1]) @ self.poses[p.frame[at]]
        z = np.einsum("nj,nj->n", T[:, 2, :3], ray) + T[:, 2, 3] * p.depth[at]
        moved = frame[a] + 1 != p.frame[at]
        depth = np.where(moved, within_sight(p.depth[at] / np.maximum(z, 1e-3)), p.depth[at])
        trust = np.where(known, p.trust[at], 0.0)
        self.points = Points(ids, frame[a], places[a], depth, trust)
        self._frames, self.poses = self._frames[1:], kept


def triangulate(rays: Array, seen: Array, T_second_first: Array) -> tuple[Array, Array]:
    """Inverse depths (N,) along rays (N, 3) of one frame seen along rays (N, 3), z = 1, of another, and how
    strongly they are determined (N,): the squared shift that an inverse depth of one makes."""
    R, t = T_second_first[..., :3, :3], T_second_first[..., :3, 3]
    turned = np.einsum("...ij,...j->...i", R, rays)
    a = seen[:, :2] * t[..., 2:] - t[..., :2]
    b = turned[:, :2] - seen[:, :2] * turned[:, 2:]
    strength = np.sum(a * a, axis=1)
    return np.sum(a * b, axis=1) / np.maximum(strength, 1e-12), strength


def _intrinsics(lens: Lens) -> Array:
    c = lens.camera
    return np.array([c.fx, c.fy, c.cx, c.cy])


def _gather(frames: list[Seen]) -> tuple[tuple[Indices, Indices, Array], Indices, Indices]:
    """Sort the sightings of all frames by point: sightings, their number and the name of each point."""
    ids = np.concatenate([seen.ids for seen in frames])
    frame = np.repeat(np.arange(len(frames)), [len(seen.ids) for seen in frames])
    order = np.argsort(ids, kind="stable")
    names, counts = np.unique(ids, return_counts=True)
    places = np.concatenate([seen.pixels for seen in frames])[order]
    return (np.concatenate([[0], np.cumsum(counts)]), frame[order], places), counts, names
