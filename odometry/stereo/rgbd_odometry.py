"""Visual odometry of a depth camera: a stereo odometry whose second view is a depth image.

    odometry = RgbdOdometry(camera)
    for image, depth in frames:
        T_world_camera = T_world_camera @ odometry.track(image, depth).T_previous_current

Depth cameras are carried in the hand and on robots that turn on the spot, in rooms. Figures for what differs from a
pair on a car: docs/decisions/depth_cameras.md.
"""

from dataclasses import dataclass, field, replace

from odometry.camera import StereoCamera
from odometry.klt_tracking import TrackingConfig
from odometry.motion_checks import MotionCheckConfig
from odometry.stereo.depth_view import DepthView, DepthViewConfig
from odometry.stereo.sliding_window import WindowConfig
from odometry.stereo.stereo_odometry import StereoOdometry, StereoOdometryConfig
from odometry.stereo.stereo_self_calibration import ExactCalibration
from odometry.stereo.two_view_adjustment import AdjustmentConfig


@dataclass(frozen=True)
class RgbdOdometryConfig:
    """Settings of the odometry of a depth camera; what they mean is said in `StereoOdometryConfig`.

    Attributes:
        tracking: choice and tracking of corners.
        depth: reading of the depth image.
        adjustment: two-view adjustment of each frame against its reference frame.
        window: sliding window over the last reference frames.
        motion_checks: checks that a motion must pass.
        reference_spacing_m: distance from the reference frame at which a frame becomes the next one, metres.
        reference_rotation_rad: rotation from the reference frame at which a frame becomes the next one, radians.
        min_reference_ratio: share of the reference frame's points below which a frame becomes the next one.
        min_followed_ratio: share of the reference frame's points that must agree with a motion; where fewer do, wider
            searches are tried too: a hand turns in a few frames.
        max_noise_px: largest noise of the measurements of a motion, pixels: depth that counts much shows as noise where
            image and depth are not of one moment.
        wide_blur_px: blur of both images in a wider search, pixels: a hand blurs single images.
        max_earlier_references: reference frames of the past that are kept, to measure from them where the camera comes
            back.
    """

    tracking: TrackingConfig = field(default_factory=TrackingConfig)
    depth: DepthViewConfig = field(default_factory=DepthViewConfig)
    adjustment: AdjustmentConfig = field(default_factory=AdjustmentConfig)
    window: WindowConfig = field(default_factory=WindowConfig)
    motion_checks: MotionCheckConfig = field(default_factory=MotionCheckConfig)
    reference_spacing_m: float = 0.1
    reference_rotation_rad: float = 0.1
    min_reference_ratio: float = 0.6
    min_followed_ratio: float = 0.35
    max_noise_px: float = 6.0
    wide_blur_px: float = 3.0
    max_earlier_references: int = 16

    def as_stereo(self) -> StereoOdometryConfig:
        """The same settings, of a stereo odometry."""
        return StereoOdometryConfig(
            tracking=replace(self.tracking, wide_blur_px=self.wide_blur_px),
            adjustment=self.adjustment,
            window=self.window,
            motion_checks=replace(
                self.motion_checks, min_followed_ratio=self.min_followed_ratio, max_noise_px=self.max_noise_px
            ),
            reference_spacing_m=self.reference_spacing_m,
            reference_rotation_rad=self.reference_rotation_rad,
            min_reference_ratio=self.min_reference_ratio,
            max_earlier_references=self.max_earlier_references,
        )


class RgbdOdometry(StereoOdometry):
    """Measures the motion of a depth camera, frame by frame."""

    def __init__(self, camera: StereoCamera, config: RgbdOdometryConfig | None = None) -> None:
        config = config or RgbdOdometryConfig()
        super().__init__(camera, config.as_stereo(), DepthView(camera, config.depth), ExactCalibration.of(camera))
