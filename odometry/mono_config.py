"""All settings of the monocular odometry."""

from dataclasses import dataclass, field

import numpy as np

from odometry.beginning import BeginningConfig
from odometry.bundle import BundleConfig
from odometry.lens import LensConfig
from odometry.motion_stereo import MotionStereoConfig
from odometry.placing import PlacingConfig
from odometry.plausibility import PlausibilityConfig
from odometry.road import RoadConfig
from odometry.tracking import TrackingConfig


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
        road: how the road is found by which scale is measured.
        height_m: of the camera above the road, metres; 0 where it is not known: then the unit is free, and as long
            as a metre only if the first images show things 15 m away, usually.
        key_px: median parallax since the last key frame that makes one, pixels.
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
    road: RoadConfig = field(default_factory=RoadConfig)
    height_m: float = 0.0
    key_px: float = 4.0
    key_share: float = 0.8
    persistence: float = 9.0
    extrapolated_rad: float = 0.02
    extrapolated_m: float = 0.2

    def __post_init__(self) -> None:
        if not (np.isfinite(self.height_m) and self.height_m >= 0):
            raise ValueError(f"height_m: expected metres above the road, or 0 for unknown, got {self.height_m}")
