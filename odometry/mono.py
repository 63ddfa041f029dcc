"""Monocular visual odometry: from each image of one camera, how it moved since the one before.

    odometry = MonoOdometry(camera)
    for image in images:
        T_world_camera = T_world_camera @ odometry.track(image).T_previous_current

There is one finite motion for every image. Where the images do not allow a measurement it is an extrapolation,
and says so. The unit of length is free at first, and kept from then on: see `MonoOdometryConfig`.
"""

from collections import deque
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.beginning import Beginning, begin
from odometry.bundle import Bundle
from odometry.camera import PinholeCamera
from odometry.lens import Lens
from odometry.mono_config import MonoOdometryConfig
from odometry.mono_locating import Known, MonoLocator
from odometry.mono_tracks import Followed, MonoFrontEnd, Tracks
from odometry.motion import FIRST_VARIANCE, Motion, unmeasured
from odometry.motion_stereo import Depths, Shot, earlier, see_depth
from odometry.placing import Placed
from odometry.plausibility import Expectation, jump
from odometry.points import Seen
from odometry.reference import Reference
from odometry.road import HeightRuler, NoRuler, Ruler
from odometry.ticks import Ticks

__all__ = ["MonoOdometry", "MonoOdometryConfig"]

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_NEW_MAP = "lost; a new map goes on at the speed before"


class MonoOdometry:
    """Measures the motion of one camera, image by image.

    Attributes:
        bundle: the map of the last key frames, and the lens as learned so far.

    """

    def __init__(self, camera: PinholeCamera, config: MonoOdometryConfig | None = None) -> None:
        self._camera, self._config = camera, config or MonoOdometryConfig()
        settings = self._config
        self._front_end = MonoFrontEnd(settings.tracking)
        self.bundle = Bundle(Lens.unknown(camera, settings.lens), settings.bundle, settings.lens)
        self._locator = MonoLocator(self._front_end, self.bundle, settings.placing, settings.plausibility)
        self._ruler: Ruler = HeightRuler(settings.height_m, settings.road) if settings.height_m else NoRuler()
        self._images: deque[Image] = deque(maxlen=settings.bundle.frames)  # of the bundle's frames
        self._ticks = Ticks()
        self._T_map_reference = np.eye(4)
        self._reference: Reference[Tracks] | None = None  # the last image whose place in the map is known
        self._candidate: Reference[Tracks] | None = None  # what a new map could begin with
        self._velocity: Array | None = None  # tangent vector of the last measured motion, per image
        self._speeds: deque[float] = deque(maxlen=2)  # of the last measured motions, metres per image
        self._unmeasured = 0  # images since the last measurement

    def track(self, image: Image, timestamp: float | None = None) -> Motion:
        """Measure the motion since the previous image.

        Args:
            image: (H, W) uint8 of the camera's size.
            timestamp: seconds; tells how long a gap in the recording is. None: no image is missing, ten a second.

        Raises:
            ValueError: an image of another size or type.

        """
        self._check(image)
        steps = self._ticks.since_last(timestamp)
        first, self._unmeasured = self._unmeasured == 0 and self._reference is None, self._unmeasured + steps
        if first:
            self._propose(image)
            return Motion(np.eye(4), FIRST_VARIANCE * np.eye(6), False, "")
        motion = np.eye(4) if self._velocity is None else se3.exp(self._velocity * steps)
        self._reference = self._reference and self._reference.older(steps)
        self._candidate = self._candidate and self._candidate.older(steps)
        return self._measure(image, motion)

    def depths(self, image: Image, pixels: Array) -> Depths:
        """Depth of pixels (N, 2) of the image that was tracked last, in the unit of the motions.

        For other stages. Nothing is known of an image whose motion was predicted.
        """
        if self._reference is None or self._unmeasured or not len(pixels):
            return Depths.unknown(len(pixels))
        tracks, points = self._reference.view, self.bundle.points
        shots = [Shot(*shot) for shot in zip(self._images, self.bundle.poses, strict=True)]
        now = Shot(image, self._T_map_reference)
        then = earlier(shots, now, 1.0 / points.usual, self._config.depths)
        seen = self.bundle.in_camera(tracks.ids, self._T_map_reference)
        known = (points.at(tracks.ids).trust > 0) & (seen[:, 2] > 0)
        if then is None or not known.any():
            return Depths.unknown(len(pixels))
        hints = tracks.pixels[known], seen[known, 3] / seen[known, 2]
        return see_depth((then, now), pixels, hints, self.bundle.lens, self._config.depths)

    def _check(self, image: Image) -> None:
        expected = (self._camera.height, self._camera.width)
        if image.shape != expected or image.dtype != np.uint8:
            raise ValueError(
                f"expected an image of {expected} uint8 as the camera says, got {image.shape} {image.dtype}"
            )

    def _measure(self, image: Image, motion: Array) -> Motion:
        """Measure from the map, else begin a new one, else go on as before: by motion (4, 4)."""
        reason = ""
        if self._reference is not None:
            known = Known(self._reference.view, self._T_map_reference)
            located = self._locator.locate(known, image, self._expect(self._reference, image, motion))
            reason = located.reason or self._unsure(located.placed)
            if located.placed is not None and not reason:
                return self._accept(self._reference, located.followed, located.placed)
        if self._candidate is not None:
            begun = self._begin(self._candidate, image, motion)
            if isinstance(begun, Motion):
                return begun
            reason = reason or begun
        return self._extrapolate(image, motion, reason or "the images before showed nothing to follow")

    def _unsure(self, placed: Placed | None) -> str:
        """Why a measurement tells less than going on as before would; empty if it tells more."""
        if placed is None:
            return ""
        variance = self._config.persistence * float(np.trace(placed.covariance[3:, 3:]))
        limit = float(np.trace(self._extrapolated(1)[3:, 3:]))
        return "" if variance < limit else "all that is followed is too far away to tell how far the camera moved"

    def _expect(self, reference: Reference[Tracks], image: Image, motion: Array) -> Expectation | None:
        """Expect the motion (4, 4) since the previous image, where one was ever measured."""
        if np.array_equal(image, reference.view.image):  # the same image again was taken at the same place
            return Expectation(np.eye(4))
        if self._velocity is None:
            return None
        T = reference.T_reference_previous @ motion
        return Expectation(T, reference.age, self._unmeasured, self._ticks.interval, reference.age * min(self._speeds))

    def _accept(self, reference: Reference[Tracks], followed: Followed, placed: Placed) -> Motion:
        """Take over what was measured; an image far enough from the last key frame becomes one."""
        T_map_camera = se3.exact(self._T_map_reference @ placed.T_first_second)
        tracks = followed.tracks.only(placed.inliers)
        if self._is_key(tracks, reference.view, T_map_camera):
            agree = self.bundle.add(Seen(tracks.ids, tracks.pixels), T_map_camera)
            self._images.append(tracks.image)
            self.bundle.rescale(self._ruler.factor(self.bundle.visible()))
            tracks, T_map_camera = self._renew(tracks.only(agree)), self.bundle.poses[-1]
        T_reference_current = se3.inverse(self._T_map_reference) @ T_map_camera
        T_previous_current = se3.inverse(reference.T_reference_previous) @ T_reference_current
        Ad = se3.adjoint(se3.inverse(T_previous_current))
        covariance = self._config.persistence * placed.covariance + Ad @ reference.covariance_previous @ Ad.T
        self._arrive(reference.velocity(T_reference_current), tracks, T_map_camera)
        return Motion(
            T_previous_current, covariance, False, "",
            followed.before, followed.tracks.pixels, placed.inliers, placed.residual_px,
        )  # fmt: skip

    def _arrive(self, velocity: Array, tracks: Tracks, T_map_camera: Array) -> None:
        """Measure from here on; velocity (6,) per image."""
        self._velocity, self._unmeasured = velocity, 0
        self._speeds.append(float(np.linalg.norm(velocity[3:])))
        self._T_map_reference, self._reference, self._candidate = T_map_camera, Reference(tracks), None

    def _is_key(self, tracks: Tracks, before: Tracks, T_map_camera: Array) -> bool:
        """Whether an image at (4, 4) is far from the last key frame: one that is not tells nothing new of depth."""
        lens, R = self.bundle.lens, T_map_camera[:3, :3].T @ self.bundle.poses[-1][:3, :3]
        parallax = tracks.pixels - lens.pixels(lens.rays(tracks.key_pixels) @ R.T)  # what turning does not explain
        flow = float(np.nanmedian(np.linalg.norm(parallax, axis=1)))
        return flow > self._config.key_px or len(tracks) < self._config.key_share * len(before)

    def _renew(self, tracks: Tracks) -> Tracks:
        """Make the newest key frame show new corners beside these points."""
        renewed = self._front_end.observe(tracks.image, tracks)
        self.bundle.show(Seen(renewed.ids, renewed.pixels))
        return renewed

    def _propose(self, image: Image) -> None:
        """Let a new map begin with this image if it shows enough."""
        tracks = self._front_end.observe(image)
        self._candidate = Reference(tracks) if len(tracks) >= self._config.beginning.tracks else None

    def _begin(self, candidate: Reference[Tracks], image: Image, motion: Array) -> Motion | str:
        """Begin a new map with the candidate and this image, or say why not."""
        followed = self._front_end.follow(candidate.view, image, candidate.view.pixels, wide=True)
        tracks = followed.tracks
        found = begin(self.bundle.lens, tracks.key_pixels, tracks.pixels, self._config.beginning)
        if isinstance(found, Beginning):
            found = self._as_expected(found, candidate.T_reference_previous @ motion)
        if isinstance(found, Beginning):
            return self._restart(candidate, followed, found, motion)
        enough = len(tracks) >= self._config.beginning.tracks
        self._candidate = replace(candidate, view=tracks) if enough else None
        return found

    def _as_expected(self, found: Beginning, T_expected: Array) -> Beginning | str:
        """Doubt a beginning that is far from the motion (4, 4) of before, the less the longer nothing was measured."""
        if self._velocity is None:
            return found
        T = found.T_first_second.copy()
        T[:3, 3] *= float(np.linalg.norm(T_expected[:3, 3]))
        return jump(T, T_expected, self._config.plausibility, self._unmeasured) or found

    def _restart(self, candidate: Reference[Tracks], followed: Followed, found: Beginning, motion: Array) -> Motion:
        """Begin a new map; its unit is such that the camera goes on as fast as before, by motion (4, 4)."""
        tracks, usual = followed.tracks.only(found.inliers), self.bundle.points.usual
        agree = self.bundle.begin(
            Seen(tracks.ids, tracks.key_pixels), Seen(tracks.ids, tracks.pixels), found.T_first_second
        )
        self._images.clear()
        self._images.extend([tracks.key_image, tracks.image])
        way = float(np.linalg.norm((candidate.T_reference_previous @ motion)[:3, 3]))
        moving = way > self._config.plausibility.moving_m
        self.bundle.rescale(way / self._way_begun() if moving else self.bundle.points.usual / usual)
        self.bundle.rescale(self._ruler.factor(self.bundle.visible()))
        tracks = self._renew(tracks.only(agree))
        T_candidate_current = se3.inverse(self.bundle.poses[0]) @ self.bundle.poses[1]
        T_previous_current = se3.inverse(candidate.T_reference_previous) @ T_candidate_current
        reason = "" if self._velocity is None else _NEW_MAP
        self._arrive(se3.log(T_candidate_current) / candidate.age, tracks, self.bundle.poses[1])
        return Motion(
            T_previous_current, self._extrapolated(1), bool(reason), reason,
            followed.before, followed.tracks.pixels, found.inliers,
        )  # fmt: skip

    def _way_begun(self) -> float:
        """Way between the first two frames of a map, in its unit."""
        return max(float(np.linalg.norm(self.bundle.poses[1, :3, 3] - self.bundle.poses[0, :3, 3])), 1e-9)

    def _extrapolated(self, images: int) -> Array:
        """Covariance (6, 6) of a motion that was not measured for so many images."""
        return unmeasured(self._config.extrapolated_rad, self._config.extrapolated_m, images)

    def _extrapolate(self, image: Image, T_previous_current: Array, reason: str) -> Motion:
        """Go on at constant velocity; a new map may begin with this image."""
        covariance = self._extrapolated(self._unmeasured)
        self._reference = self._reference and self._reference.bridged(T_previous_current, covariance)
        if self._candidate is None:
            self._propose(image)
        else:
            self._candidate = self._candidate.bridged(T_previous_current, covariance)
        return Motion(T_previous_current, covariance, True, reason)

    def state(self) -> dict[str, Any]:
        """Everything that changes from image to image: dicts, lists, plain values and arrays, for a checkpoint."""
        reference, candidate = (
            None if found is None else found.state(dict(vars(found.view)))
            for found in (self._reference, self._candidate)
        )
        return {
            "front_end": self._front_end.state(),
            "map": self.bundle.state(),
            "scale_correction": self._ruler.state(),
            "map_images": list(self._images),
            "frame_counter": self._ticks.state(),
            "T_map_reference": self._T_map_reference,
            "reference": reference,
            "candidate": candidate,
            "velocity": self._velocity,
            "speeds": list(self._speeds),
            "frames_unmeasured": self._unmeasured,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue, bit for bit, from the state of another odometry of the same camera and configuration.

        Raises:
            KeyError, TypeError, ValueError: the state is of another odometry.
        """
        self._front_end.restore(state["front_end"])
        self.bundle.restore(state["map"])
        self._ruler.restore(state["scale_correction"])
        self._images = deque(state["map_images"], maxlen=self._images.maxlen)
        self._ticks.restore(state["frame_counter"])
        self._T_map_reference = state["T_map_reference"]
        self._reference = self._restored_reference(state["reference"])
        self._candidate = self._restored_reference(state["candidate"])
        self._velocity, self._unmeasured = state["velocity"], state["frames_unmeasured"]
        self._speeds = deque(state["speeds"], maxlen=self._speeds.maxlen)

    def _restored_reference(self, state: dict[str, Any] | None) -> Reference[Tracks] | None:
        if state is None:
            return None
        tracks = Tracks(**state["view"])
        self._check(tracks.image)
        return Reference(**(state | {"view": tracks}))
