"""Bundle adjustment over the last key frames of one camera: poses, inverse depths and the lens together.

Scale is what a single camera drifts in, and what carries it on are points that live long in a long window: the
older key frames are fixed, which costs nothing but their sightings, and the newer ones are adjusted. A point that
outlives the frame that saw it first is anchored in the next one, where it should have been seen. Depths are
eliminated point by point (Triggs et al., Bundle Adjustment, 1999, section 6). Memory is bounded by the window.

What frames knew that have left it is forgotten. (Measured: carried on as weights of the depths it brings twice to
eight times the error, because it holds on to the lens as it was thought to be.)
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.kernels.mono_bundle_adjustment import build_normal_equations
from odometry.camera import within_sight
from odometry.lens import COEFFICIENTS, Lens, LensConfig
from odometry.points import Points, Seen, Sightings, settled
from odometry.triangulation import triangulate

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

_LIMIT = 9.21  # chi squared, 99 %, two residuals of a sighting
_TAIL = 2.0  # tracks err more often by much than Gauss allows: so many times the limit is what an outlier exceeds
_MEDIAN = 1.386  # of chi squared
_NOISE_AT_FIRST = 0.5  # pixels; the largest that is assumed as well
_DAMPING = 1e-3  # information, 1/rad² and 1/m²: keeps matrices regular
_STEPS_AT_FIRST = 10
_FIXED = -1
_FAR = 1e-3  # inverse depth below which a point is too far to be placed
_SEEN = 1e-8  # squared shift by parallax, squared slope of a ray, below which nothing is seen of a depth


@dataclass(frozen=True)
class BundleConfig:
    """How much is adjusted together.

    Attributes:
        frames: key frames in the window.
        free: of them, the newest that are adjusted; the older ones stay where they are.
        iterations: steps for each new key frame, which start from the window before.
        floor_px: smallest noise level of a measurement that is believed, pixels.
        memory: share of a track's error that it still has in the next key frame.
        repeats: windows in which one track is seen, so that it does not teach the lens anew in each.

    """

    frames: int = 12
    free: int = 6
    iterations: int = 2
    floor_px: float = 0.05
    memory: float = 0.5
    repeats: float = 400.0


class Bundle:
    """Keeps the last key frames and adjusts them.

    Attributes:
        lens: as learned so far.
        poses: (K, 4, 4) T_map_frame.
        points: what is known of the points.
        noise_px: standard deviation of a measurement, pixels.

    """

    def __init__(self, lens: Lens, config: BundleConfig, lens_config: LensConfig) -> None:
        self._config, self._lens_config = config, lens_config
        self._frames: list[Seen] = []
        self.lens, self.poses, self.points = lens, np.zeros((0, 4, 4)), Points.none()
        self.noise_px = _NOISE_AT_FIRST

    def begin(self, first: Seen, second: Seen, T_first_second: Array) -> Mask:
        """Begin a new map with two frames, the first at its origin; which of the second's points agree (N,)."""
        self._frames, self.points = [first, second], Points.none()
        self.poses = np.stack([np.eye(4), T_first_second])
        return self._adjust(1, _STEPS_AT_FIRST)

    def add(self, seen: Seen, T_map_frame: Array) -> Mask:
        """Add a key frame about where it is said to be, (4, 4), and adjust; which of its points agree (N,)."""
        if len(self._frames) >= self._config.frames:
            self._frames = self._frames[1:]
            self.points = self.points.anchored(Sightings.of(self._frames), self.poses, self.lens)
            self.poses = self.poses[1:]
        self._frames.append(seen)
        self.poses = np.concatenate([self.poses, T_map_frame[None]])
        return self._adjust(min(self._config.free, len(self.poses) - 2), self._config.iterations)

    def show(self, seen: Seen) -> None:
        """Change what the newest frame shows: without points that do not agree, with new ones."""
        self._frames[-1] = seen
        known = self.points.ids
        new = seen.ids > (known[-1] if len(known) else -1)
        unknown = np.zeros(int(new.sum()))
        frame = np.full(len(unknown), len(self._frames) - 1)
        fresh = Points(seen.ids[new], frame, seen.pixels[new], unknown + self.points.usual, unknown)
        self.points = self.points.joined(fresh)

    def rescale(self, factor: float) -> None:
        """Make everything larger by a factor, the newest frame staying where it is: no image contradicts that."""
        newest = self.poses[-1, :3, 3]
        self.poses = self.poses.copy()
        self.poses[:, :3, 3] = newest + factor * (self.poses[:, :3, 3] - newest)
        self.points = self.points.scaled(factor)

    def predict(self, ids: Indices, T_map_camera: Array) -> Array:
        """Where a camera at (4, 4) sees tracks, pixels (N, 2), NaN behind it; the depth of new ones is guessed."""
        return self.lens.pixels(self.in_camera(ids, T_map_camera)[:, :3])

    def in_camera(self, ids: Indices, T_map_camera: Array) -> Array:
        """Tracks as seen by a camera at (4, 4): homogeneous points (N, 4), finite at infinity."""
        points = self.points.at(ids)
        T = se3.inverse(T_map_camera) @ self.poses[points.frame]
        turned = np.einsum("nij,nj->ni", T[:, :3, :3], self.lens.rays(points.place))
        return np.concatenate([turned + T[:, :3, 3] * points.depth[:, None], points.depth[:, None]], axis=1)

    def visible(self) -> Array:
        """Points (N, 3) of known depth in the newest frame's camera."""
        known = self.points.trust > 0
        points = self.in_camera(self.points.ids[known], self.poses[-1])
        near = points[:, 3] > _FAR
        return np.asarray(points[near, :3] / points[near, 3:])

    def _adjust(self, free: int, iterations: int) -> Mask:
        """Gauss-Newton on the newest poses, the depths and the lens; which points of the newest frame agree (N,).

        Changes nothing if it does not converge.
        """
        sightings = Sightings.of(self._frames)
        problem = _Problem(sightings, self._known(sightings), self.poses, free, self.lens, self._config.repeats)
        for _ in range(iterations):
            problem.step(self.noise_px, self._config.memory)
            noise = float(np.sqrt(np.median(problem.chi2[sightings.followed()]) / _MEDIAN))
            self.noise_px = float(np.clip(noise, self._config.floor_px, _NOISE_AT_FIRST))
        if problem.is_finite():
            self.poses, self.points = problem.poses, problem.points()
            information = problem.about_lens() / self._config.repeats
            self.lens = self.lens.learned(problem.lens, information, self._lens_config)
        newest = sightings.frame == len(self._frames) - 1
        names = np.repeat(sightings.ids, sightings.counts)[newest]
        agree = problem.chi2[newest] < _TAIL * _LIMIT * self.noise_px**2
        return np.asarray(agree[np.searchsorted(names, self._frames[-1].ids)])

    def _known(self, sightings: Sightings) -> Points:
        """Points with the depths that are known, and triangulated ones where they are not."""
        a, z = sightings.first[:-1], sightings.first[1:] - 1
        places = sightings.places
        known = self.points.at(sightings.ids)
        T_last_first = se3.inverse(self.poses[sightings.frame[z]]) @ self.poses[sightings.frame[a]]
        depth, strength = triangulate(self.lens.rays(places[a]), self.lens.rays(places[z]), T_last_first)
        depth = np.where(strength > _SEEN, within_sight(depth), self.points.usual)
        depth = np.where(known.trust > 0, known.depth, depth)
        place = np.where(known.trust[:, None] > 0, known.place, places[a])
        return Points(sightings.ids, sightings.anchor, place, depth, known.trust)


class _Problem:
    """The state of one adjustment and its Gauss-Newton steps."""

    def __init__(
        self, sightings: Sightings, points: Points, poses: Array, free: int, lens: Lens, repeats: float
    ) -> None:
        self._sightings, self._points = sightings, points
        self._measured = sightings.places[sightings.first[:-1]]
        self._state = np.column_stack([points.place - self._measured, points.depth])
        self.poses, self._prior, self.lens = poses, lens, lens.coefficients
        # What the window says will be said again by the next ones: what is known already counts as often.
        self._information = repeats * np.linalg.inv(lens.covariance)
        self._states = np.full(len(poses), _FIXED)
        self._states[len(poses) - free :] = 6 * np.arange(free)

    def step(self, sigma: float, memory: float) -> None:
        """One step with the noise level sigma, pixels."""
        s, points = self._sightings, self._points
        H, b, self.chi2, rows, offset, self._trust = build_normal_equations(
            intrinsics(self._prior), (s.first, s.frame, s.places), (self._state, points.depth, np.zeros(len(points))),
            self.poses, self._states, self.lens, (_LIMIT * sigma**2, memory, 1.0),
        )  # fmt: skip
        self._H = H / sigma**2 + _DAMPING * np.eye(len(b))
        A, g = self._H.copy(), b / sigma**2
        A[-COEFFICIENTS:, -COEFFICIENTS:] += self._information
        g[-COEFFICIENTS:] += self._information @ (self.lens - self._prior.coefficients)
        change = np.linalg.solve(A, -g)
        self._state = settled(self._state - offset - rows @ change)
        self.lens = self.lens + change[-COEFFICIENTS:]
        self.poses = self.poses.copy()
        for k in np.flatnonzero(self._states != _FIXED):
            self.poses[k] = self.poses[k] @ se3.exp(change[self._states[k] : self._states[k] + 6])

    def is_finite(self) -> bool:
        """Whether it has come to anything."""
        return all(np.isfinite(values).all() for values in (self.poses, self._state, self.lens))

    def points(self) -> Points:
        """The points with their new depths."""
        p, several = self._points, self._sightings.counts > 1
        trust = np.where(several, self._trust, 0.0)
        return Points(p.ids, p.frame, self._measured + self._state[:, :2], self._state[:, 2], trust)

    def about_lens(self) -> Array:
        """What the window said about the lens, (3, 3)."""
        cross = self._H[:-COEFFICIENTS, -COEFFICIENTS:]
        known = self._H[-COEFFICIENTS:, -COEFFICIENTS:] - cross.T @ np.linalg.solve(
            self._H[:-COEFFICIENTS, :-COEFFICIENTS], cross
        )
        return 0.5 * (known + known.T)


def intrinsics(lens: Lens) -> Array:
    """(4,) fx, fy, cx, cy, pixels."""
    c = lens.camera
    return np.array([c.fx, c.fy, c.cx, c.cy])
