"""Settings of the monocular odometry."""

from dataclasses import dataclass, field

import numpy as np

from odometry.distortion import LensDistortionConfig
from odometry.klt_tracking import TrackingConfig
from odometry.mono.ground_plane_scale import GroundPlaneConfig
from odometry.mono.mono_bundle_adjustment import MonoBundleConfig
from odometry.mono.mono_initialization import InitializationConfig
from odometry.mono.motion_only_bundle_adjustment import PoseEstimationConfig
from odometry.mono.motion_stereo import MotionStereoConfig
from odometry.motion import EXTRAPOLATION_SIGMA_M, EXTRAPOLATION_SIGMA_RAD
from odometry.motion_checks import MotionCheckConfig


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
    extrapolation_sigma_rad: float = EXTRAPOLATION_SIGMA_RAD
    extrapolation_sigma_m: float = EXTRAPOLATION_SIGMA_M

    def __post_init__(self) -> None:
        if not (np.isfinite(self.camera_height_m) and self.camera_height_m >= 0):
            raise ValueError(
                f"camera_height_m: expected metres above the road, or 0 for unknown, got {self.camera_height_m}"
            )
