"""Monocular visual odometry: from each image of one camera, how it moved since the one before.

    odometry = MonoOdometry(camera)
    for image in images:
        T_world_camera = T_world_camera @ odometry.track(image).T_previous_current

There is one finite motion for every image. Where the images do not allow a measurement it is an extrapolation,
and says so. The unit of length is free at first, and kept from then on: see `MonoOdometryConfig`.
"""

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.beginning import Beginning, BeginningConfig, begin
from odometry.bundle import Bundle, BundleConfig
from odometry.camera import PinholeCamera
from odometry.lens import Lens, LensConfig
from odometry.mono_tracks import Followed, MonoFrontEnd, Tracks
from odometry.motion import Motion
from odometry.motion_stereo import Depths, MotionStereoConfig, Shot, earlier, see_depth
from odometry.placing import Placed, PlacingConfig, place
from odometry.plausibility import Expectation, PlausibilityConfig, doubt, jump
from odometry.points import Seen
from odometry.reference import Reference
from odometry.ticks import Ticks
from odometry.tracking import TrackingConfig

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_FIRST_VARIANCE = 1e-12  # rad², m²: the first image is where it is by definition
_MEDIAN_DEPTH = 15.0  # of the points of the first map: the unit while nothing tells it, metres on a street, about


@dataclass(frozen=True)
class MonoOdometryConfig:
    """All settings of the odometry; the defaults serve any camera without much distortion.

    Attributes:
        tracking: how corners are chosen and followed.
        beginning: what the first two images must show.
        bundle: how the last key frames are adjusted.
        placing: how the pose of an image is computed.
        lens: what is thought of the lens at first.
        depths: how the depth of any pixels is found.
        plausibility: when a result is not believed.
        key_px: median flow since the last key frame that makes one, pixels.
        key_share: share of the last key frame's points that must still be followed, or else there is a new one.
        persistence: how many times more variance motions have, as parts of a stretch, than their points would
            have if these erred independently in every image: tracks keep their errors while they live.
        extrapolated_rad: standard deviation of the change of rotation from one image to the next.
        extrapolated_m: standard deviation of the change of translation from one image to the next, metres.

    """

    tracking: TrackingConfig = field(default_factory=TrackingConfig)
    beginning: BeginningConfig = field(default_factory=BeginningConfig)
    bundle: BundleConfig = field(default_factory=BundleConfig)
    placing: PlacingConfig = field(default_factory=PlacingConfig)
    lens: LensConfig = field(default_factory=LensConfig)
    depths: MotionStereoConfig = field(default_factory=MotionStereoConfig)
    plausibility: PlausibilityConfig = field(default_factory=PlausibilityConfig)
    key_px: float = 4.0
    key_share: float = 0.8
    persistence: float = 9.0
    extrapolated_rad: float = 0.02
    extrapolated_m: float = 0.2


class MonoOdometry:
    """Measures the motion of one camera, image by image."""

    def __init__(self, camera: PinholeCamera, config: MonoOdometryConfig | None = None) -> None:
        self._camera, self._config = camera, config or MonoOdometryConfig()
        self._front_end = MonoFrontEnd(self._config.tracking)
        self.bundle = Bundle(Lens.unknown(camera, self._config.lens), self._config.bundle, self._config.lens)
        self._images: deque[Image] = deque(maxlen=self._config.bundle.frames)  # of the bundle's frames
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
        self._unmeasured += steps
        if self._reference is None and self._candidate is None:
            self._candidate = Reference(self._front_end.observe(image))
            return Motion(np.eye(4), _FIRST_VARIANCE * np.eye(6), False, "")
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
        shots = [Shot(image, T) for image, T in zip(self._images, self.bundle.poses, strict=True)]
        now = Shot(image, self._T_map_reference)
        then = earlier(shots, now, 1.0 / points.usual, self._config.depths)
        seen = self.bundle.in_camera(tracks.ids, self._T_map_reference)
        known = (points.at(tracks.ids).trust > 0) & (seen[:, 2] > 0)
        if then is None or not known.any():
            return Depths.unknown(len(pixels))
        hints = tracks.pixels[known], seen[known, 3] / seen[known, 2]
        return see_depth(then, now, pixels, hints, self.bundle.lens, self._config.depths)

    def _check(self, image: Image) -> None:
        expected = (self._camera.height, self._camera.width)
        if image.shape != expected or image.dtype != np.uint8:
            raise ValueError(f"expected an image {expected} uint8 as the camera says, got {image.shape} {image.dtype}")

    def _measure(self, image: Image, motion: Array) -> Motion:
        """Measure from the map, else begin a new one, else go on as before: by motion (4, 4)."""
        located = "" if self._reference is None else self._locate(self._reference, image, motion)
        if isinstance(located, Motion):
            return located
        begun = self._begin(image, motion)
        if isinstance(begun, Motion):
            return begun
        return self._extrapolate(image, motion, located or begun)

    def _locate(self, reference: Reference[Tracks], image: Image, motion: Array) -> Motion | str:
        expected = self._expect(reference, image, motion)
        guess = np.eye(4) if expected is None else expected.T
        reason = ""
        for wide in (False, True):
            followed, placed = self._follow(reference.view, image, guess, wide)
            reason = doubt(placed, expected, self._config.plausibility)
            if placed is not None and not reason:
                return self._accept(reference, followed, placed)
        return reason

    def _follow(self, tracks: Tracks, image: Image, guess: Array, wide: bool) -> tuple[Followed, Placed | None]:
        followed, placed = self._place(tracks, image, guess, wide)
        if placed is None or not jump(placed.T_first_second, guess, self._config.plausibility):
            return followed, placed
        # Tracks that had to be found far from where they were looked for are few: look again where they are.
        again, second = self._place(tracks, image, placed.T_first_second, wide)
        better = second is not None and second.inliers.sum() >= placed.inliers.sum()
        return (again, second) if better else (followed, placed)

    def _place(self, tracks: Tracks, image: Image, guess: Array, wide: bool) -> tuple[Followed, Placed | None]:
        ahead = self.bundle.predict(tracks.ids, self._T_map_reference @ guess)
        followed = self._front_end.follow(tracks, image, ahead, wide)
        if len(followed.tracks) < self._config.plausibility.tracks:
            return followed, None
        return followed, place(self.bundle, followed.tracks, self._T_map_reference, guess, self._config.placing)

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
        if self._is_key(tracks):
            agree = self.bundle.add(Seen(tracks.ids, tracks.pixels), T_map_camera)
            self._images.append(tracks.image)
            tracks = self._renew(tracks.only(agree))
            T_map_camera = self.bundle.poses[-1]
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
        """Measure from here on."""
        self._velocity, self._unmeasured = velocity, 0
        self._speeds.append(float(np.linalg.norm(velocity[3:])))
        self._T_map_reference, self._reference, self._candidate = T_map_camera, Reference(tracks), None

    def _is_key(self, tracks: Tracks) -> bool:
        """Whether an image with these points is far from the last key frame. One that is not would tell nothing new."""
        if not len(tracks):
            return False
        flow = float(np.median(np.linalg.norm(tracks.pixels - tracks.key_pixels, axis=1)))
        assert self._reference is not None
        return flow > self._config.key_px or len(tracks) < self._config.key_share * len(self._reference.view)

    def _renew(self, tracks: Tracks) -> Tracks:
        """Make the newest frame show new corners beside these points."""
        renewed = self._front_end.observe(tracks.image, tracks)
        self.bundle.show(Seen(renewed.ids, renewed.pixels))
        return renewed

    def _begin(self, image: Image, motion: Array) -> Motion | str:
        """Begin a new map with the candidate and this image, or say why not."""
        if self._candidate is None:
            return ""
        followed = self._front_end.follow(self._candidate.view, image, self._candidate.view.pixels, wide=True)
        tracks = followed.tracks
        found = begin(self.bundle.lens, tracks.key_pixels, tracks.pixels, self._config.beginning)
        if isinstance(found, Beginning):
            return self._restart(self._candidate, followed, found, motion)
        if len(tracks) < self._config.beginning.tracks:
            self._candidate = None
        else:
            self._candidate = Reference(
                tracks, self._candidate.T_reference_previous, self._candidate.T_reference_measured,
                self._candidate.covariance_previous, self._candidate.age,
            )  # fmt: skip
        return found

    def _restart(self, candidate: Reference[Tracks], followed: Followed, found: Beginning, motion: Array) -> Motion:
        """Begin a new map; its unit is such that the camera goes on as fast as before."""
        tracks = followed.tracks.only(found.inliers)
        first = Seen(tracks.ids, tracks.key_pixels)
        expected = float(np.linalg.norm((candidate.T_reference_previous @ motion)[:3, 3]))
        fresh = self._velocity is None
        agree = self.bundle.begin(first, Seen(tracks.ids, tracks.pixels), np.eye(4), found.T_first_second)
        self._images.clear()
        self._images.extend([tracks.key_image, tracks.image])
        way = float(np.linalg.norm(self.bundle.poses[-1, :3, 3] - self.bundle.poses[0, :3, 3]))
        self.bundle.rescale(_MEDIAN_DEPTH * self.bundle.points.usual if fresh else expected / max(way, 1e-9))
        tracks = self._renew(tracks.only(agree))
        T_reference_current = se3.inverse(self.bundle.poses[0]) @ self.bundle.poses[1]
        T_previous_current = se3.inverse(candidate.T_reference_previous) @ T_reference_current
        reason = "" if fresh else "lost; a new map goes on at the speed before"
        covariance = self._extrapolated(1)
        self._arrive(se3.log(T_reference_current) / candidate.age, tracks, self.bundle.poses[-1])
        return Motion(T_previous_current, covariance, not fresh, reason, followed.before, followed.tracks.pixels, found.inliers)

    def _extrapolated(self, images: int) -> Array:
        """Covariance (6, 6) of a motion that was not measured: it grows with the time that nothing was."""
        deviation = np.repeat([self._config.extrapolated_rad, self._config.extrapolated_m], 3) * images
        return np.diag(deviation**2)

    def _extrapolate(self, image: Image, T_previous_current: Array, reason: str) -> Motion:
        """Go on at constant velocity; a new map may begin with this image."""
        covariance = self._extrapolated(self._unmeasured)
        if self._reference is not None:
            self._reference = self._reference.bridged(T_previous_current, covariance)
        if self._candidate is not None:
            self._candidate = self._candidate.bridged(T_previous_current, covariance)
        else:
            tracks = self._front_end.observe(image)
            if len(tracks) >= self._config.beginning.tracks:
                self._candidate = Reference(tracks)
        return Motion(T_previous_current, covariance, True, reason)
