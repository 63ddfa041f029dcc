"""Monocular visual odometry: from each image of one camera, how it moved since the one before.

    odometry = MonoOdometry(camera)
    for image in images:
        T_world_camera = T_world_camera @ odometry.track(image).T_previous_current

There is one finite motion for every image. Where the images do not allow a measurement, it is an extrapolation with
`Motion.predicted` set. The unit of length is free at first, and kept from then on: see `MonoOdometryConfig`.
"""

from collections import deque
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.camera import PinholeCamera
from odometry.mono.mono_config import MonoOdometryConfig
from odometry.mono.mono_frontend import FollowedTracks, MonoFrontEnd, MonoTracks
from odometry.mono.mono_initialization import MIN_NOISE_PX, Initialization, NewDepths, find_depths, initialize
from odometry.mono.mono_map import MonoMap
from odometry.mono.mono_tracking import MonoTracker, MonoTrackingResult, PosedTracks
from odometry.mono.motion_only_bundle_adjustment import PoseEstimate
from odometry.mono.motion_stereo import Depths, PosedImage, estimate_depths, select_earlier_image
from odometry.mono.rotation_estimation import estimate_rotation, explains_as_well
from odometry.motion import FIRST_VARIANCE, FrameCounter, Motion, extrapolation_covariance
from odometry.motion_checks import MotionPrediction, jump_reason, stops_implausibly
from odometry.reference_frame import Reference

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_NEW_MAP = "lost; a new map goes on at the speed before"
_NEW_DEPTHS = "turned away from all known depths; the median depth of the scene stays as before"
_TOO_FAR = "all that is followed is too far away to tell how far the camera moved"
_STOPPING_S = 0.5  # seconds in which a camera that moved may come to a stand
_MIN_SPEEDS, _MAX_SPEEDS = 2, 30  # measured motions of which the slowest counts; the largest number serves 60 Hz
# Points of known depth that measure a translation, and its distance from none: a step before a wall looks like a turn.
_MIN_SURE, _TRANSLATION_SIGMAS = 50, 5.0
# A rotation may leave this residual, in noise levels, to all but a few tracks: what is near shows a translation first.
_MAX_HIDDEN, _MIN_TURNED = 4.0, 0.8
_FEW_TRACKS = 0.25  # of the largest number: where fewer agree on a jump, they may be wrong together


class MonoOdometry:
    """Measures the motion of one camera, image by image.

    Attributes:
        bundle: the map of the last reference frames, and the lens distortion as learned so far.
    """

    def __init__(self, camera: PinholeCamera, config: MonoOdometryConfig | None = None) -> None:
        self._camera, self._config = camera, config or MonoOdometryConfig()
        settings = self._config
        self._front_end = MonoFrontEnd(settings.tracking)
        self._map = MonoMap(camera, settings, self._front_end)
        self.bundle = self._map.bundle
        self._tracker = MonoTracker(self._front_end, self.bundle, settings.pose_estimation, settings.motion_checks)
        self._frame_counter = FrameCounter()
        self._T_map_reference = np.eye(4)
        self._reference: Reference[MonoTracks] | None = None  # the last image whose pose in the map is known
        self._candidate: Reference[MonoTracks] | None = None  # what a new map could begin with
        self._velocity: Array | None = None  # tangent vector of the last measured motion, per image
        self._speeds: deque[float] = deque(maxlen=_MAX_SPEEDS)  # of the last measured motions, metres per image
        self._unmeasured = 0  # images since the last measurement
        self._has_begun = False

    def track(self, image: Image, timestamp: float | None = None, mask: Image | None = None) -> Motion:
        """Measure the motion since the previous image.

        Args:
            image: (H, W) uint8 of the camera's size.
            timestamp: seconds, from which gaps in the recording are found; None if no image is missing, at 10 Hz.
            mask: (H, W) uint8, 0 where the image does not show the scene; None if it shows it everywhere.

        Raises:
            ValueError: an image of another size or type.
        """
        self._check(image)
        self._front_end.mask = mask
        steps = self._frame_counter.frames_since_last(timestamp)
        self._unmeasured += steps
        if not self._has_begun:
            self._has_begun = True
            self._propose(image)
            return Motion(np.eye(4), FIRST_VARIANCE * np.eye(6), False, "")
        motion = np.eye(4) if self._velocity is None else se3.exp(self._velocity * steps)
        self._reference = self._reference and self._reference.age(steps)
        self._candidate = self._candidate and self._candidate.age(steps)
        return self._measure(image, motion)

    def depths(self, image: Image, pixels: Array) -> Depths:
        """Depth of pixels (N, 2) of the image that was tracked last, in the unit of the motions.

        For other stages. Nothing is known of an image whose motion was predicted.
        """
        if self._reference is None or self._reference.age_frames or not len(pixels):
            return Depths.unknown(len(pixels))
        tracks, points = self._reference.view, self.bundle.points
        shots = self._map.posed_images()
        now = PosedImage(image, self._T_map_reference)
        then = select_earlier_image(shots, now, self._map.median_depth, self._config.motion_stereo)
        seen = self.bundle.in_camera(tracks.ids, self._T_map_reference)
        known = (points.select(tracks.ids).information > 0) & (seen[:, 2] > 0)
        if then is None or not known.any():
            return Depths.unknown(len(pixels))
        hints = tracks.pixels[known], seen[known, 3] / seen[known, 2]
        return estimate_depths((then, now), pixels, hints, self.bundle.lens, self._config.motion_stereo)

    def _check(self, image: Image) -> None:
        expected = (self._camera.height, self._camera.width)
        if image.shape != expected or image.dtype != np.uint8:
            raise ValueError(
                f"expected an image of {expected} uint8 as the camera says, got {image.shape} {image.dtype}"
            )

    def _measure(self, image: Image, motion: Array) -> Motion:
        """Measure from the map, else begin a new map, else extrapolate by the motion (4, 4)."""
        reason = None
        if self._reference is not None:
            known = PosedTracks(self._reference.view, self._T_map_reference)
            expected = self._expect(self._reference, image, motion)
            located = self._tracker.track(known, image, expected)
            turned = self._turn(located, expected)
            if turned is not None:
                return self._accept(self._reference, located.followed, turned, adjust=False)
            reason = located.reason or self._weakness(located.estimate)
            if located.estimate is not None and not reason:
                return self._accept(
                    self._reference, located.followed, self._add_jump_variance(located.estimate, expected)
                )
            moved = self._find_depths(located.followed.tracks, expected)
            if moved is not None:
                return self._accept_depths(self._reference, located.followed, moved)
            again = self._relocalize(self._reference, image, motion)
            if again is not None:
                return again
            if reason == _TOO_FAR:
                motion = self._turn_expected(self._reference, located.followed.tracks, motion)
        if self._candidate is not None:
            begun = self._begin(self._candidate, image, motion)
            if isinstance(begun, Motion):
                return begun
            reason = reason or begun
        return self._extrapolate(image, motion, reason or "the images before showed nothing to follow")

    def _relocalize(self, reference: Reference[MonoTracks], image: Image, motion: Array) -> Motion | None:
        """Find a lost camera again in the map, not too far from where it would be by its last motion (4, 4).

        None if it is not lost, or nowhere to be found.
        """
        recognized = self._map.recognize(image) if self._unmeasured > 1 else None
        if recognized is None:
            return None
        view, T_view_camera = recognized
        T_expected = self._T_map_reference @ reference.T_reference_previous @ motion
        checks, patience = self._config.motion_checks, 2 * self._unmeasured
        if jump_reason(
            view.T_map_camera @ T_view_camera, T_expected, checks, patience
        ):  # another shelf of the same kind
            return None
        located = self._tracker.track(view, image, MotionPrediction(T_view_camera))
        if located.estimate is None or located.reason or self._weakness(located.estimate):
            return None
        T_view_previous = se3.inverse(view.T_map_camera) @ self._T_map_reference @ reference.T_reference_previous
        self._T_map_reference = view.T_map_camera
        covariance = reference.covariance_previous
        back = Reference(view.tracks, T_view_previous, T_view_previous, covariance, reference.age_frames)
        return self._accept(back, located.followed, located.estimate)

    def _weakness(self, estimate: PoseEstimate | None) -> str | None:
        """Reason why a measurement is less certain than an extrapolation would be, or None if it is more certain."""
        if estimate is None:
            return None
        variance = self._config.covariance_scale * float(np.trace(estimate.covariance[3:, 3:]))
        limit = float(np.trace(self._extrapolation_covariance(1)[3:, 3:]))
        return None if variance < limit else _TOO_FAR

    def _add_jump_variance(self, estimate: PoseEstimate, predicted: MotionPrediction | None) -> PoseEstimate:
        """A measured pose; one far from the predicted pose by few points is as uncertain as the two differ."""
        few = int(estimate.inliers.sum()) < _FEW_TRACKS * self._config.tracking.max_corners
        if predicted is None or not few:
            return estimate
        T, T_predicted = estimate.T_first_second, predicted.T_reference_current
        if not jump_reason(T, T_predicted, self._config.motion_checks, predicted.frames):
            return estimate
        variances = np.square(se3.log(se3.inverse(T_predicted) @ T)) / self._config.covariance_scale
        return replace(estimate, covariance=estimate.covariance + np.diag(variances))

    def _turn(self, located: MonoTrackingResult, predicted: MotionPrediction | None) -> PoseEstimate | None:
        """Rotation since the last reference frame, where that explains all that is seen; else None."""
        if located.estimate is None:
            return None
        tracks = located.followed.tracks
        noise_px = max(located.estimate.noise_px, self.bundle.noise_px, MIN_NOISE_PX)
        sure = int(self.bundle.points.select(tracks.ids).is_sure(noise_px).sum())
        if not located.reason and sure >= _MIN_SURE and self._shows_translation(located.estimate):
            return None
        found = estimate_rotation(self.bundle.lens, tracks.reference_pixels, tracks.pixels, self._map.median_depth)
        if not explains_as_well(found, located.estimate, noise_px, len(tracks) - sure):
            return None
        T_first_second = se3.inverse(self._T_map_reference) @ self.bundle.poses[-1] @ found.T_first_second
        return self._check_turn(replace(found, T_first_second=T_first_second), predicted)

    def _turn_expected(self, reference: Reference[MonoTracks], tracks: MonoTracks, motion: Array) -> Array:
        """The motion (4, 4) since the previous image with the rotation that the tracks show, if they agree on one.

        Where no depth is known, the translation is not measured; the rotation is, all the same.
        """
        found = estimate_rotation(self.bundle.lens, tracks.reference_pixels, tracks.pixels, self._map.median_depth)
        if found.inliers.mean() < _MIN_TURNED:
            return motion
        T_reference_current = se3.inverse(self._T_map_reference) @ self.bundle.poses[-1] @ found.T_first_second
        turned = motion.copy()
        turned[:3, :3] = reference.T_reference_previous[:3, :3].T @ T_reference_current[:3, :3]
        return turned

    def _shows_translation(self, estimate: PoseEstimate) -> bool:
        """Whether a pose is away from the last reference frame by far more than its uncertainty."""
        T = se3.inverse(self.bundle.poses[-1]) @ self._T_map_reference @ estimate.T_first_second
        moved, covariance = T[:3, :3].T @ T[:3, 3], self._config.covariance_scale * estimate.covariance[3:, 3:]
        return float(moved @ np.linalg.solve(covariance, moved)) > _TRANSLATION_SIGMAS**2

    def _check_turn(self, found: PoseEstimate, predicted: MotionPrediction | None) -> PoseEstimate | None:
        """Reject a rotation that hides parallax, or a translation that cannot have ended."""
        checks = self._config.motion_checks
        limit_px = _MAX_HIDDEN * max(self.bundle.noise_px, MIN_NOISE_PX)
        agree = int(np.sum(found.chi2 < limit_px**2))
        if agree < max(checks.min_tracks, _MIN_TURNED * len(found.chi2)):
            return None
        if predicted is not None and stops_implausibly(found.T_first_second, predicted, checks):
            return None
        return found

    def _find_depths(self, tracks: MonoTracks, predicted: MotionPrediction | None) -> NewDepths | None:
        """Find depths anew where no known ones are in view; None if there is no parallax or an impossible motion."""
        found = find_depths(self.bundle, tracks, self._config.initialization)
        if isinstance(found, str):
            return None
        T = se3.inverse(self._T_map_reference) @ self.bundle.poses[-1] @ found.T_first_second
        checks = self._config.motion_checks
        if predicted is not None and (
            stops_implausibly(T, predicted, checks)
            or jump_reason(T, predicted.T_reference_current, checks, self._unmeasured)
        ):
            return None
        return replace(found, T_first_second=T)

    def _accept_depths(self, reference: Reference[MonoTracks], followed: FollowedTracks, found: NewDepths) -> Motion:
        """Accept a motion to where depths are found anew; with a guessed scale it counts as predicted."""
        noise_px, covariance = self.bundle.noise_px, self._extrapolation_covariance(1)
        if found.is_scale_known:
            covariance = covariance / self._config.covariance_scale
        chi2 = np.full(len(found.inliers), noise_px**2)
        placed = PoseEstimate(found.T_first_second, covariance, found.inliers, noise_px, noise_px, chi2)
        motion = self._accept(reference, followed, placed)
        return motion if found.is_scale_known else replace(motion, predicted=True, reason=_NEW_DEPTHS)

    def _expect(self, reference: Reference[MonoTracks], image: Image, motion: Array) -> MotionPrediction | None:
        """Predict the pose from the motion (4, 4) since the previous image; None before the first measurement."""
        if np.array_equal(image, reference.view.image):  # the same image again was taken at the same place
            return MotionPrediction(np.eye(4))
        if self._velocity is None:
            return None
        T_reference_current = reference.T_reference_previous @ motion
        distance_m = reference.age_frames * self._lasting_speed()
        return MotionPrediction(
            T_reference_current, reference.age_frames, self._unmeasured, self._frame_counter.interval_s, distance_m
        )

    def _lasting_speed(self) -> float:
        """The lowest speed of the last half second, units per image; 0 before the first measurement.

        Where few depths are left, as in a door, one speed may be far too high: what follows is no stop then.
        """
        count = max(_MIN_SPEEDS, round(_STOPPING_S / self._frame_counter.interval_s))
        return min(list(self._speeds)[-count:], default=0.0)

    def _accept(
        self, reference: Reference[MonoTracks], followed: FollowedTracks, placed: PoseEstimate, adjust: bool = True
    ) -> Motion:
        """Accept a measured pose; an image far enough from the last reference frame of the bundle is added to it."""
        T_map_camera = se3.orthonormalize(self._T_map_reference @ placed.T_first_second)
        tracks = followed.tracks.select(placed.inliers)
        if self._map.is_far_from_reference(tracks, T_map_camera):
            tracks = self._map.add(tracks, T_map_camera, adjust)
            T_map_camera = self.bundle.poses[-1]
        T_reference_current = se3.inverse(self._T_map_reference) @ T_map_camera
        T_previous_current = se3.inverse(reference.T_reference_previous) @ T_reference_current
        Ad = se3.adjoint(se3.inverse(T_previous_current))
        covariance = self._config.covariance_scale * placed.covariance + Ad @ reference.covariance_previous @ Ad.T
        self._arrive(reference.velocity(T_reference_current), tracks, T_map_camera)
        return Motion(
            T_previous_current, covariance, False, "",
            followed.before, followed.tracks.pixels, placed.inliers, placed.residual_px,
        )  # fmt: skip

    def _arrive(self, velocity: Array, tracks: MonoTracks, T_map_camera: Array) -> None:
        """Measure from here on; velocity (6,) per image."""
        self._velocity, self._unmeasured = velocity, 0
        self._speeds.append(float(np.linalg.norm(velocity[3:])))
        self._T_map_reference, self._reference, self._candidate = T_map_camera, Reference(tracks), None

    def _propose(self, image: Image) -> None:
        """Make this image the candidate for a new map if it shows enough points."""
        tracks = self._front_end.observe(image)
        self._candidate = Reference(tracks) if len(tracks) >= self._config.initialization.min_points else None

    def _begin(self, candidate: Reference[MonoTracks], image: Image, motion: Array) -> Motion | str:
        """Begin a new map with the candidate and this image, or return the reason why not."""
        followed = self._front_end.follow(candidate.view, image, candidate.view.pixels, wide=True)
        tracks = followed.tracks
        found = initialize(self.bundle.lens, tracks.reference_pixels, tracks.pixels, self._config.initialization)
        if isinstance(found, Initialization):
            found = self._check_prediction(found, candidate.T_reference_previous @ motion)
        if isinstance(found, Initialization):
            return self._restart(candidate, followed, found, motion)
        turned = self._turn_before_map(candidate, followed, motion)
        if turned is not None:
            return turned
        enough = len(tracks) >= self._config.initialization.min_points
        self._candidate = replace(candidate, view=tracks) if enough else None
        return found

    def _turn_before_map(
        self, candidate: Reference[MonoTracks], followed: FollowedTracks, motion: Array
    ) -> Motion | None:
        """Measure a rotation since the candidate for a new map, where that explains what is seen."""
        tracks, settings = followed.tracks, self._config
        if len(tracks) < settings.initialization.min_points or not self._may_stand(candidate):
            return None
        found = estimate_rotation(self.bundle.lens, tracks.reference_pixels, tracks.pixels, self._map.median_depth)
        expected = candidate.T_reference_previous @ motion
        predicted = MotionPrediction(
            expected, candidate.age_frames, self._unmeasured, self._frame_counter.interval_s,
            candidate.age_frames * self._lasting_speed(),
        )  # fmt: skip
        turned = self._check_turn(found, predicted if self._velocity is not None else None)
        if turned is None:
            return None
        T_previous_current = se3.inverse(candidate.T_reference_previous) @ turned.T_first_second
        Ad = se3.adjoint(se3.inverse(T_previous_current))
        covariance = turned.covariance + Ad @ candidate.covariance_previous @ Ad.T
        self._unmeasured = 0
        if self._velocity is not None:
            self._velocity = np.concatenate([se3.log(T_previous_current)[:3], np.zeros(3)])
            self._speeds.append(0.0)
        self._reference = self._reference and self._reference.extend(T_previous_current, covariance)
        self._candidate = (
            Reference(self._front_end.observe(tracks.image, tracks))
            if len(tracks) < settings.min_tracked_ratio * tracks.reference_count
            else replace(
                candidate, view=tracks, T_reference_previous=turned.T_first_second, covariance_previous=np.zeros((6, 6))
            )
        )
        return Motion(
            T_previous_current, covariance, False, "",
            followed.before, followed.tracks.pixels, turned.inliers, turned.residual_px,
        )  # fmt: skip

    def _may_stand(self, candidate: Reference[MonoTracks]) -> bool:
        """Whether the camera may have come to a stand: it was not moving, or has been out of sight for a while."""
        moving = self._velocity is not None and bool(self._velocity[3:].any())
        return not moving or candidate.age_frames * self._frame_counter.interval_s >= _STOPPING_S

    def _check_prediction(self, found: Initialization, T_expected: Array) -> Initialization | str:
        """Reject an initialization far from the predicted motion (4, 4), farther the longer nothing was measured."""
        if self._velocity is None:
            return found
        T = found.T_first_second.copy()
        T[:3, 3] *= float(np.linalg.norm(T_expected[:3, 3]))
        return jump_reason(T, T_expected, self._config.motion_checks, self._unmeasured) or found

    def _restart(
        self, candidate: Reference[MonoTracks], followed: FollowedTracks, found: Initialization, motion: Array
    ) -> Motion:
        """Begin a new map in a unit such that the camera goes on as fast as before, by the motion (4, 4)."""
        distance = float(np.linalg.norm((candidate.T_reference_previous @ motion)[:3, 3]))
        moving = distance > self._config.motion_checks.min_moving_m
        tracks = self._map.begin(
            followed.tracks.select(found.inliers), found.T_first_second, distance if moving else None
        )
        T_candidate_current = se3.inverse(self.bundle.poses[0]) @ self.bundle.poses[1]
        T_previous_current = se3.inverse(candidate.T_reference_previous) @ T_candidate_current
        reason = "" if self._velocity is None else _NEW_MAP
        self._arrive(se3.log(T_candidate_current) / candidate.age_frames, tracks, self.bundle.poses[1])
        return Motion(
            T_previous_current, self._extrapolation_covariance(1), bool(reason), reason,
            followed.before, followed.tracks.pixels, found.inliers,
        )  # fmt: skip

    def _extrapolation_covariance(self, images: int) -> Array:
        """Covariance (6, 6) of a motion that was not measured for a number of images."""
        return extrapolation_covariance(
            self._config.extrapolation_sigma_rad, self._config.extrapolation_sigma_m, images
        )

    def _extrapolate(self, image: Image, T_previous_current: Array, reason: str) -> Motion:
        """Extrapolate at constant velocity; this image becomes the candidate for a new map."""
        covariance = self._extrapolation_covariance(self._unmeasured)
        self._reference = self._reference and self._reference.extend(T_previous_current, covariance)
        if self._candidate is None:
            self._propose(image)
        else:
            self._candidate = self._candidate.extend(T_previous_current, covariance)
        return Motion(T_previous_current, covariance, True, reason)

    def state(self) -> dict[str, Any]:
        """Everything that changes from image to image: dicts, lists, plain values and arrays, for a checkpoint."""
        reference, candidate = (
            None if found is None else found.state(dict(vars(found.view)))
            for found in (self._reference, self._candidate)
        )
        return {
            "front_end": self._front_end.state(),
            "map": self._map.state(),
            "frame_counter": self._frame_counter.state(),
            "T_map_reference": self._T_map_reference,
            "reference": reference,
            "candidate": candidate,
            "velocity": self._velocity,
            "speeds": list(self._speeds),
            "frames_unmeasured": self._unmeasured,
            "has_begun": self._has_begun,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue, bit for bit, from the state of another odometry of the same camera and configuration.

        Raises:
            KeyError, TypeError, ValueError: the state is of another odometry.
        """
        self._front_end.restore(state["front_end"])
        self._map.restore(state["map"])
        self._frame_counter.restore(state["frame_counter"])
        self._T_map_reference = state["T_map_reference"]
        self._reference = self._restored_reference(state["reference"])
        self._candidate = self._restored_reference(state["candidate"])
        self._velocity, self._unmeasured = state["velocity"], state["frames_unmeasured"]
        self._has_begun = state["has_begun"]
        self._speeds = deque(state["speeds"], maxlen=self._speeds.maxlen)

    def _restored_reference(self, state: dict[str, Any] | None) -> Reference[MonoTracks] | None:
        if state is None:
            return None
        tracks = MonoTracks(**state["view"])
        self._check(tracks.image)
        return Reference(**(state | {"view": tracks}))
