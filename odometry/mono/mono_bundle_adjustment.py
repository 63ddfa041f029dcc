"""Bundle adjustment over the last reference frames of one camera: poses, points and lens distortion together.

A single camera drifts in scale, which is carried on by points that live long in a long window. The older frames of the
window are fixed and cost nothing but their observations; the newer ones are adjusted. A point that outlives the frame
that saw it first is anchored in the next one. Memory is bounded by the window, and what leaves it is forgotten:
docs/decisions/no_marginalisation.md. Residuals and Jacobians: docs/math.md, section "Monocular bundle".
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.camera import clamp_inverse_depth, triangulate
from odometry.distortion import NUM_COEFFICIENTS, LensDistortion, LensDistortionConfig
from odometry.inverse_depth_points import FrameObservations, ObservationTable, Points, clamp_points
from odometry.kernels.mono_bundle_equations import build_normal_equations
from odometry.kernels.schur import FIXED
from odometry.mono.local_map import MapFrame

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

_LIMIT = 9.21  # 99 % quantile of chi squared with two degrees of freedom, the residuals of an observation
_TAIL = 2.0  # errors of tracks have heavier tails than a Gaussian: an outlier exceeds this multiple of the limit
_MEDIAN = 1.386  # median of the same distribution
_NOISE_AT_FIRST = 0.5  # pixels; the largest that is assumed as well
_DAMPING = 1e-3  # information, 1/rad² and 1/m²: keeps matrices regular
_STEPS_AT_FIRST = 10
_MIN_INVERSE_DEPTH = 1e-3  # below it a point is too far away to have a position
_MIN_PARALLAX = 1e-8  # squared shift of a ray's slope by parallax, below which a depth is not triangulated


@dataclass(frozen=True)
class MonoBundleConfig:
    """Size of the window and of its adjustment.

    Attributes:
        max_frames: reference frames in the window.
        max_free_frames: newest frames of the window that are adjusted; the older ones are fixed.
        iterations: Gauss-Newton steps for each new frame, which start from the window before.
        min_noise_px: smallest noise level of a measurement that is assumed, pixels.
        error_correlation: share of a track's error that it still has in the next frame.
        windows_per_track: windows in which one track is seen, so that its error does not count anew in each of them
            when the lens is learned.
    """

    max_frames: int = 12
    max_free_frames: int = 6
    iterations: int = 2
    min_noise_px: float = 0.05
    error_correlation: float = 0.5
    windows_per_track: int = 400


class MonoBundle:
    """The last reference frames of one camera, adjusted together.

    Attributes:
        lens: the camera and its distortion as learned so far.
        poses: (K, 4, 4) T_map_frame.
        points: points of the window.
        numbers: numbers of its frames, growing.
        noise_px: standard deviation of a measurement, pixels.
    """

    def __init__(self, lens: LensDistortion, config: MonoBundleConfig, lens_config: LensDistortionConfig) -> None:
        self._config, self._lens_config = config, lens_config
        self._frames: list[FrameObservations] = []
        self.numbers: list[int] = []
        self._num_named = 0  # frames that have had a number: none is given twice, even if the newest frame leaves
        self.lens, self.poses, self.points = lens, np.zeros((0, 4, 4)), Points.empty()
        self.noise_px = _NOISE_AT_FIRST

    def initialize(self, first: FrameObservations, second: FrameObservations, T_first_second: Array) -> Mask:
        """Begin a new map with two frames, the first at its origin; return which of the second's points agree (N,)."""
        self._frames, self.points, self.numbers = [first, second], Points.empty(), self._name(2)
        self.poses = np.stack([np.eye(4), T_first_second])
        return self._adjust(1, _STEPS_AT_FIRST)

    @property
    def is_full(self) -> bool:
        """Whether the window holds as many frames as it may."""
        return len(self._frames) >= self._config.max_frames

    def add(self, seen: FrameObservations, T_map_frame: Array) -> Mask:
        """Add a frame near its measured pose (4, 4) and adjust; return which of its points agree (N,)."""
        self.add_turned(seen, T_map_frame)
        return self._adjust(min(self._config.max_free_frames, len(self.poses) - 2), self._config.iterations)

    def add_turned(self, seen: FrameObservations, T_map_frame: Array) -> None:
        """Add a frame without parallax at its measured pose (4, 4): it has nothing to say about any depth."""
        if self.is_full:
            self.remove(0)
        self._frames.append(seen)
        self.numbers += self._name(1)
        self.poses = np.concatenate([self.poses, T_map_frame[None]])

    def remove(self, place: int) -> None:
        """Forget a frame of the window."""
        del self._frames[place], self.numbers[place]
        table = ObservationTable.from_frames(self._frames)
        self.points = self.points.reanchor(table, self.poses, self.lens, place)
        self.poses = np.delete(self.poses, place, axis=0)

    def revisit(self, frame: MapFrame) -> None:
        """Take back a frame of the local map, as the window's oldest, with its landmarks as they were."""
        self._frames.insert(0, FrameObservations(frame.ids, frame.pixels))
        self.numbers.insert(0, frame.number)
        self.poses = np.concatenate([frame.T_map_camera[None], self.poses])
        old = replace(self.points, frame=self.points.frame + 1)
        anchor = np.zeros(len(frame.ids), np.int64)
        self.points = old.merge(Points(frame.ids, anchor, frame.pixels, frame.inverse_depth, frame.information))

    def landmarks_of(self, place: int, image: Image) -> MapFrame:
        """A frame of the window for the local map, with its points of known depth."""
        seen, T = self._frames[place], self.poses[place]
        points, there = self.points.select(seen.ids), self.in_camera(seen.ids, T)
        depth = there[:, 3] / np.where(there[:, 2] > 0, there[:, 2], np.inf)
        sure = (depth > _MIN_INVERSE_DEPTH) & points.is_sure(self.noise_px)
        information = points.information * (points.inverse_depth / np.maximum(depth, _MIN_INVERSE_DEPTH)) ** 2
        return MapFrame(
            self.numbers[place], image, T, seen.ids[sure], seen.pixels[sure], depth[sure], information[sure]
        )

    def _name(self, count: int) -> list[int]:
        """Numbers for new frames."""
        self._num_named += count
        return list(range(self._num_named - count, self._num_named))

    def replace_newest(self, seen: FrameObservations) -> None:
        """Replace the newest frame's observations: outliers are gone and new points are there."""
        self._frames[-1] = seen
        new = ~np.isin(seen.ids, self.points.ids)
        unknown = np.zeros(int(new.sum()))
        frame = np.full(len(unknown), len(self._frames) - 1)
        fresh = Points(seen.ids[new], frame, seen.pixels[new], unknown + self.points.median_inverse_depth, unknown)
        self.points = self.points.merge(fresh)

    def rescale(self, factor: float) -> None:
        """Make the map larger by a factor around the newest frame, which no image contradicts."""
        newest = self.poses[-1, :3, 3]
        self.poses = self.poses.copy()
        self.poses[:, :3, 3] = newest + factor * (self.poses[:, :3, 3] - newest)
        self.points = self.points.rescale(factor)

    def predict(self, ids: Indices, T_map_camera: Array) -> Array:
        """Pixels (N, 2) at which a camera at (4, 4) sees tracks, NaN behind it; new tracks have the median depth."""
        return self.lens.pixels(self.in_camera(ids, T_map_camera)[:, :3])

    def in_camera(self, ids: Indices, T_map_camera: Array) -> Array:
        """Homogeneous points (N, 4) of tracks in the frame of a camera at (4, 4), finite at infinity."""
        points = self.points.select(ids)
        T = se3.inverse(T_map_camera) @ self.poses[points.frame]
        turned = np.einsum("nij,nj->ni", T[:, :3, :3], self.lens.rays(points.anchor_pixel))
        return np.concatenate(
            [turned + T[:, :3, 3] * points.inverse_depth[:, None], points.inverse_depth[:, None]], axis=1
        )

    def visible(self) -> Array:
        """Points (N, 3) of known depth in the newest frame's camera."""
        known = self.points.information > 0
        points = self.in_camera(self.points.ids[known], self.poses[-1])
        near = points[:, 3] > _MIN_INVERSE_DEPTH
        return np.asarray(points[near, :3] / points[near, 3:])

    def _adjust(self, free: int, iterations: int) -> Mask:
        """Adjust the newest poses, the points and the lens; return which points of the newest frame agree (N,).

        Nothing changes if the adjustment does not converge.
        """
        observations = ObservationTable.from_frames(self._frames)
        problem = _BundleProblem(
            observations, self._known(observations), self.poses, free, self.lens, self._config.windows_per_track
        )
        for _ in range(iterations):
            problem.step(self.noise_px, self._config.error_correlation)
            noise = float(np.sqrt(np.median(problem.chi2[observations.is_followed()]) / _MEDIAN))
            self.noise_px = float(np.clip(noise, self._config.min_noise_px, _NOISE_AT_FIRST))
        if problem.is_finite():
            self.poses, self.points = problem.poses, problem.points()
            information = problem.lens_information() / self._config.windows_per_track
            self.lens = self.lens.update(problem.lens, information, self._lens_config)
        newest = observations.frame == len(self._frames) - 1
        names = np.repeat(observations.ids, observations.counts)[newest]
        agree = problem.chi2[newest] < _TAIL * _LIMIT * self.noise_px**2
        return np.asarray(agree[np.searchsorted(names, self._frames[-1].ids)])

    def _known(self, observations: ObservationTable) -> Points:
        """Points of the window with their known depths, or with triangulated ones."""
        a, z = observations.first[:-1], observations.first[1:] - 1
        places = observations.pixels
        known = self.points.select(observations.ids)
        T_last_first = se3.inverse(self.poses[observations.frame[z]]) @ self.poses[observations.frame[a]]
        depth, strength = triangulate(self.lens.rays(places[a]), self.lens.rays(places[z]), T_last_first)
        depth = np.where(strength > _MIN_PARALLAX, clamp_inverse_depth(depth), self.points.median_inverse_depth)
        depth = np.where(known.information > 0, known.inverse_depth, depth)
        place = np.where(known.information[:, None] > 0, known.anchor_pixel, places[a])
        return Points(observations.ids, observations.anchor, place, depth, known.information)

    def state(self) -> dict[str, Any]:
        """Reference frames, poses, points and the lens as learned, for a checkpoint."""
        return {
            "frames": [dict(vars(frame)) for frame in self._frames],
            "lens_coefficients": self.lens.coefficients,
            "lens_covariance": self.lens.covariance,
            "poses": self.poses,
            "numbers": list(self.numbers),
            "num_named": self._num_named,
            "points": dict(vars(self.points)),
            "noise_px": self.noise_px,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._frames = [FrameObservations(**frame) for frame in state["frames"]]
        self.lens = LensDistortion(self.lens.camera, state["lens_coefficients"], state["lens_covariance"])
        self.poses, self.points = state["poses"], Points(**state["points"])
        self.numbers, self._num_named = list(state["numbers"]), state["num_named"]
        self.noise_px = state["noise_px"]


class _BundleProblem:
    """The state of one adjustment and its Gauss-Newton steps."""

    def __init__(
        self,
        observations: ObservationTable,
        points: Points,
        poses: Array,
        free: int,
        lens: LensDistortion,
        repeats: int,
    ) -> None:
        self._observations, self._points = observations, points
        self._measured = observations.pixels[observations.first[:-1]]
        self._state = np.column_stack([points.anchor_pixel - self._measured, points.inverse_depth])
        self.poses, self._prior, self.lens = poses, lens, lens.coefficients
        # The next windows will repeat this window's measurements, so the prior counts as often.
        self._information = repeats * np.linalg.inv(lens.covariance)
        self._states = np.full(len(poses), FIXED)
        self._states[len(poses) - free :] = 6 * np.arange(free)

    def step(self, sigma: float, memory: float) -> None:
        """One step with the noise level sigma, pixels."""
        s, points = self._observations, self._points
        H, b, self.chi2, rows, offset, self._depth_information = build_normal_equations(
            intrinsics(self._prior), (s.first, s.frame, s.pixels),
            (self._state, points.inverse_depth, np.zeros(len(points))),
            self.poses, self._states, self.lens, (_LIMIT * sigma**2, memory, 1.0),
        )  # fmt: skip
        self._H = H / sigma**2 + _DAMPING * np.eye(len(b))
        A, g = self._H.copy(), b / sigma**2
        A[-NUM_COEFFICIENTS:, -NUM_COEFFICIENTS:] += self._information
        g[-NUM_COEFFICIENTS:] += self._information @ (self.lens - self._prior.coefficients)
        change = np.linalg.solve(A, -g)
        self._state = clamp_points(self._state - offset - rows @ change)
        self.lens = self.lens + change[-NUM_COEFFICIENTS:]
        self.poses = self.poses.copy()
        for k in np.flatnonzero(self._states != FIXED):
            self.poses[k] = self.poses[k] @ se3.exp(change[self._states[k] : self._states[k] + 6])

    def is_finite(self) -> bool:
        """Whether poses, points and lens are all finite."""
        return all(np.isfinite(values).all() for values in (self.poses, self._state, self.lens))

    def points(self) -> Points:
        """The points with their new depths."""
        p, several = self._points, self._observations.counts > 1
        trust = np.where(several, self._depth_information, 0.0)
        return Points(p.ids, p.frame, self._measured + self._state[:, :2], self._state[:, 2], trust)

    def lens_information(self) -> Array:
        """Information (3, 3) of the window about the lens."""
        cross = self._H[:-NUM_COEFFICIENTS, -NUM_COEFFICIENTS:]
        known = self._H[-NUM_COEFFICIENTS:, -NUM_COEFFICIENTS:] - cross.T @ np.linalg.solve(
            self._H[:-NUM_COEFFICIENTS, :-NUM_COEFFICIENTS], cross
        )
        return 0.5 * (known + known.T)


def intrinsics(lens: LensDistortion) -> Array:
    """(4,) fx, fy, cx, cy, pixels."""
    c = lens.camera
    return np.array([c.fx, c.fy, c.cx, c.cy])
