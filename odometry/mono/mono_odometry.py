"""Monocular visual odometry: from each image of one camera, how it moved since the one before.

    odometry = MonoOdometry(camera)
    for image in images:
        T_world_camera = T_world_camera @ odometry.track(image).T_previous_current

There is one finite motion for every image. Where the images do not allow a measurement, it is an extrapolation with
`Motion.predicted` set. The unit of length is free at first, and kept from then on: see `MonoOdometryConfig`.
"""

from collections import deque
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.camera import PinholeCamera
from odometry.distortion import LensDistortion, LensDistortionConfig
from odometry.inverse_depth_points import FrameObservations
from odometry.klt_tracking import TrackingConfig
from odometry.mono.ground_plane_scale import GroundPlaneConfig, GroundPlaneScale, NullScaleCorrection, ScaleCorrection
from odometry.mono.mono_bundle_adjustment import MonoBundle, MonoBundleConfig
from odometry.mono.mono_frontend import FollowedTracks, MonoFrontEnd, MonoTracks
from odometry.mono.mono_initialization import Initialization, InitializationConfig, initialize
from odometry.mono.mono_tracking import MonoTracker, PosedTracks
from odometry.mono.motion_only_bundle_adjustment import PoseEstimate, PoseEstimationConfig
from odometry.mono.motion_stereo import Depths, MotionStereoConfig, PosedImage, estimate_depths, select_earlier_image
from odometry.motion import FIRST_VARIANCE, FrameCounter, Motion, extrapolation_covariance
from odometry.motion_checks import MotionCheckConfig, MotionPrediction, jump_reason
from odometry.reference_frame import Reference

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_NEW_MAP = "lost; a new map goes on at the speed before"


@dataclass(frozen=True)
class MonoOdometryConfig:
    """All settings of the odometry; the defaults serve any camera without much distortion.

    Attributes:
        tracking: choice and tracking of corners.
        initialization: what the first two images must show.
        bundle: adjustment of the last reference frames.
        pose_estimation: motion-only adjustment of each image.
        lens: prior of the lens distortion.
        motion_stereo: depth of any pixels of an image.
        motion_checks: checks that a motion must pass.
        ground_plane: how the road is found that gives the scale.
        camera_height_m: height of the camera above the road, metres; 0 if unknown: then the unit is free, and as long
            as a metre only if the median depth in the first images is 15 m.
        reference_parallax_px: median parallax to the last reference frame at which an image becomes one, pixels.
        min_tracked_ratio: share of the reference frame's points below which an image becomes the next one.
        covariance_scale: how many times more variance motions have, as parts of a stretch, than their points would
            have if these erred independently in every image: tracks keep their errors while they live.
        extrapolation_sigma_rad: standard deviation of the change of rotation from one image to the next, radians.
        extrapolation_sigma_m: standard deviation of the change of translation from one image to the next, metres.
    """

    tracking: TrackingConfig = field(default_factory=TrackingConfig)
    initialization: InitializationConfig = field(default_factory=InitializationConfig)
    bundle: MonoBundleConfig = field(default_factory=MonoBundleConfig)
    pose_estimation: PoseEstimationConfig = field(default_factory=PoseEstimationConfig)
    lens: LensDistortionConfig = field(default_factory=LensDistortionConfig)
    motion_stereo: MotionStereoConfig = field(default_factory=MotionStereoConfig)
    motion_checks: MotionCheckConfig = field(default_factory=MotionCheckConfig)
    ground_plane: GroundPlaneConfig = field(default_factory=GroundPlaneConfig)
    camera_height_m: float = 0.0
    reference_parallax_px: float = 4.0
    min_tracked_ratio: float = 0.8
    covariance_scale: float = 9.0
    extrapolation_sigma_rad: float = 0.02
    extrapolation_sigma_m: float = 0.2

    def __post_init__(self) -> None:
        if not (np.isfinite(self.camera_height_m) and self.camera_height_m >= 0):
            raise ValueError(
                f"camera_height_m: expected metres above the road, or 0 for unknown, got {self.camera_height_m}"
            )


class MonoOdometry:
    """Measures the motion of one camera, image by image.

    Attributes:
        bundle: the map of the last reference frames, and the lens distortion as learned so far.
    """

    def __init__(self, camera: PinholeCamera, config: MonoOdometryConfig | None = None) -> None:
        self._camera, self._config = camera, config or MonoOdometryConfig()
        settings = self._config
        self._front_end = MonoFrontEnd(settings.tracking)
        self.bundle = MonoBundle(LensDistortion.unknown(camera, settings.lens), settings.bundle, settings.lens)
        self._tracker = MonoTracker(self._front_end, self.bundle, settings.pose_estimation, settings.motion_checks)
        self._scale_correction: ScaleCorrection = (
            GroundPlaneScale(settings.camera_height_m, settings.ground_plane)
            if settings.camera_height_m
            else NullScaleCorrection()
        )
        self._images: deque[Image] = deque(maxlen=settings.bundle.max_frames)  # of the bundle's frames
        self._frame_counter = FrameCounter()
        self._T_map_reference = np.eye(4)
        self._reference: Reference[MonoTracks] | None = None  # the last image whose pose in the map is known
        self._candidate: Reference[MonoTracks] | None = None  # what a new map could begin with
        self._velocity: Array | None = None  # tangent vector of the last measured motion, per image
        self._speeds: deque[float] = deque(maxlen=2)  # of the last measured motions, metres per image
        self._unmeasured = 0  # images since the last measurement

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
        first, self._unmeasured = self._unmeasured == 0 and self._reference is None, self._unmeasured + steps
        if first:
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
        if self._reference is None or self._unmeasured or not len(pixels):
            return Depths.unknown(len(pixels))
        tracks, points = self._reference.view, self.bundle.points
        shots = [PosedImage(*shot) for shot in zip(self._images, self.bundle.poses, strict=True)]
        now = PosedImage(image, self._T_map_reference)
        then = select_earlier_image(shots, now, 1.0 / points.median_inverse_depth, self._config.motion_stereo)
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
            located = self._tracker.track(known, image, self._expect(self._reference, image, motion))
            reason = located.reason or self._weakness(located.estimate)
            if located.estimate is not None and not reason:
                return self._accept(self._reference, located.followed, located.estimate)
        if self._candidate is not None:
            begun = self._begin(self._candidate, image, motion)
            if isinstance(begun, Motion):
                return begun
            reason = reason or begun
        return self._extrapolate(image, motion, reason or "the images before showed nothing to follow")

    def _weakness(self, estimate: PoseEstimate | None) -> str | None:
        """Reason why a measurement is less certain than an extrapolation would be, or None if it is more certain."""
        if estimate is None:
            return None
        variance = self._config.covariance_scale * float(np.trace(estimate.covariance[3:, 3:]))
        limit = float(np.trace(self._extrapolation_covariance(1)[3:, 3:]))
        return None if variance < limit else "all that is followed is too far away to tell how far the camera moved"

    def _expect(self, reference: Reference[MonoTracks], image: Image, motion: Array) -> MotionPrediction | None:
        """Predict the pose from the motion (4, 4) since the previous image; None before the first measurement."""
        if np.array_equal(image, reference.view.image):  # the same image again was taken at the same place
            return MotionPrediction(np.eye(4))
        if self._velocity is None:
            return None
        T_reference_current = reference.T_reference_previous @ motion
        distance_m = reference.age_frames * min(self._speeds)
        return MotionPrediction(
            T_reference_current, reference.age_frames, self._unmeasured, self._frame_counter.interval_s, distance_m
        )

    def _accept(self, reference: Reference[MonoTracks], followed: FollowedTracks, placed: PoseEstimate) -> Motion:
        """Accept a measured pose; an image far enough from the last reference frame of the bundle is added to it."""
        T_map_camera = se3.orthonormalize(self._T_map_reference @ placed.T_first_second)
        tracks = followed.tracks.select(placed.inliers)
        if self._is_far_from_reference(tracks, reference.view, T_map_camera):
            agree = self.bundle.add(FrameObservations(tracks.ids, tracks.pixels), T_map_camera)
            self._images.append(tracks.image)
            self.bundle.rescale(self._scale_correction.update(self.bundle.visible()))
            tracks, T_map_camera = self._renew(tracks.select(agree)), self.bundle.poses[-1]
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

    def _is_far_from_reference(self, tracks: MonoTracks, before: MonoTracks, T_map_camera: Array) -> bool:
        """Whether an image at (4, 4) has enough parallax to the last reference frame to add to it."""
        lens, R = self.bundle.lens, T_map_camera[:3, :3].T @ self.bundle.poses[-1][:3, :3]
        turned = lens.pixels(lens.rays(tracks.reference_pixels) @ R.T)
        parallax = tracks.pixels - turned  # what turning does not explain
        flow = float(np.nanmedian(np.linalg.norm(parallax, axis=1)))
        return flow > self._config.reference_parallax_px or len(tracks) < self._config.min_tracked_ratio * len(before)

    def _renew(self, tracks: MonoTracks) -> MonoTracks:
        """Add new corners to the newest frame of the bundle."""
        renewed = self._front_end.observe(tracks.image, tracks)
        self.bundle.replace_newest(FrameObservations(renewed.ids, renewed.pixels))
        return renewed

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
        enough = len(tracks) >= self._config.initialization.min_points
        self._candidate = replace(candidate, view=tracks) if enough else None
        return found

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
        tracks, before = followed.tracks.select(found.inliers), self.bundle.points.median_inverse_depth
        agree = self.bundle.initialize(
            FrameObservations(tracks.ids, tracks.reference_pixels),
            FrameObservations(tracks.ids, tracks.pixels),
            found.T_first_second,
        )
        self._images.clear()
        self._images.extend([tracks.reference_image, tracks.image])
        distance = float(np.linalg.norm((candidate.T_reference_previous @ motion)[:3, 3]))
        moving = distance > self._config.motion_checks.min_moving_m
        by_depth = self.bundle.points.median_inverse_depth / before
        self.bundle.rescale(distance / self._initial_distance() if moving else by_depth)
        self.bundle.rescale(self._scale_correction.update(self.bundle.visible()))
        tracks = self._renew(tracks.select(agree))
        T_candidate_current = se3.inverse(self.bundle.poses[0]) @ self.bundle.poses[1]
        T_previous_current = se3.inverse(candidate.T_reference_previous) @ T_candidate_current
        reason = "" if self._velocity is None else _NEW_MAP
        self._arrive(se3.log(T_candidate_current) / candidate.age_frames, tracks, self.bundle.poses[1])
        return Motion(
            T_previous_current, self._extrapolation_covariance(1), bool(reason), reason,
            followed.before, followed.tracks.pixels, found.inliers,
        )  # fmt: skip

    def _initial_distance(self) -> float:
        """Distance between the first two frames of a map, in its unit."""
        return max(float(np.linalg.norm(self.bundle.poses[1, :3, 3] - self.bundle.poses[0, :3, 3])), 1e-9)

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
            "map": self.bundle.state(),
            "scale_correction": self._scale_correction.state(),
            "map_images": list(self._images),
            "frame_counter": self._frame_counter.state(),
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
        self._scale_correction.restore(state["scale_correction"])
        self._images = deque(state["map_images"], maxlen=self._images.maxlen)
        self._frame_counter.restore(state["frame_counter"])
        self._T_map_reference = state["T_map_reference"]
        self._reference = self._restored_reference(state["reference"])
        self._candidate = self._restored_reference(state["candidate"])
        self._velocity, self._unmeasured = state["velocity"], state["frames_unmeasured"]
        self._speeds = deque(state["speeds"], maxlen=self._speeds.maxlen)

    def _restored_reference(self, state: dict[str, Any] | None) -> Reference[MonoTracks] | None:
        if state is None:
            return None
        tracks = MonoTracks(**state["view"])
        self._check(tracks.image)
        return Reference(**(state | {"view": tracks}))
