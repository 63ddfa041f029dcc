"""Configuration of a simulated dataset: it determines every pixel.

NumPy is imported where it is used: help shows the defaults, and the import of NumPy takes longer than all else of it.
"""

import math
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from slam.errors import ConfigError

if TYPE_CHECKING:
    import numpy as np

    from odometry.camera import StereoCamera

SHAPES = ("circle", "figure-eight", "blocks")
FORMAT = 3  # raised whenever the same configuration gives other files

# The camera of KITTI's first recording day, at its own image size.
_KITTI_WIDTH, _KITTI_HEIGHT = 1241, 376
_KITTI_FOCAL, _KITTI_CX, _KITTI_CY, _KITTI_BASELINE = 718.856, 607.1928, 185.2157, 0.54

Ranges = tuple[tuple[str, float, float], ...]  # names of fields with their smallest and largest values


@dataclass(frozen=True)
class Difficulty:
    """What makes a drive hard for visual odometry; the defaults are a perfect camera in a car at constant speed.

    The calibration file always holds the values that a user would believe; these are the errors of what it says.

    Attributes:
        real_sensor: whether there are noise, blur, vignetting, exposure changes and wind.
        rectification_error_px: peak of the smooth error of each pair of pixels that rectification has left.
        lens_error_px: distortion that the calibration has left in both cameras, 45 degrees off the axis.
        local_error_px: root mean square of the error that no model of a lens describes, each camera's own.
        focal_error_percent: error of the focal length of both cameras, too long or too short.
        principal_point_error_px: distance of the principal point of both cameras from where the calibration has it.
        rig_drift_px: root mean square of the slow movement of the right camera against the left, by heat and shaking.
        exposure_jitter_percent: standard deviation of the brightness of each image, since each camera controls its own.
        max_yaw_rad_per_s: how fast the car turns; it slows down for corners.
        max_lateral_m_per_s2, max_braking_m_per_s2, max_speeding_m_per_s2: its accelerations, metres per second squared.

    Pixels are those of KITTI's image size.
    """

    real_sensor: bool = False
    rectification_error_px: float = 0.0
    lens_error_px: float = 0.0
    local_error_px: float = 0.0
    focal_error_percent: float = 0.0
    principal_point_error_px: float = 0.0
    rig_drift_px: float = 0.0
    exposure_jitter_percent: float = 0.0
    max_yaw_rad_per_s: float = math.inf
    max_lateral_m_per_s2: float = math.inf
    max_braking_m_per_s2: float = math.inf
    max_speeding_m_per_s2: float = math.inf


# The values of `street` are measured on real drives: docs/decisions/simulation_rendering.md.
DIFFICULTIES = {
    "clean": Difficulty(),
    "standard": Difficulty(True, rectification_error_px=0.6, lens_error_px=12.0),
    "street": Difficulty(
        True,
        rectification_error_px=1.9,
        lens_error_px=12.0,
        local_error_px=0.06,
        focal_error_percent=0.4,
        principal_point_error_px=2.5,
        rig_drift_px=0.06,
        exposure_jitter_percent=1.8,
        max_yaw_rad_per_s=0.7,
        max_lateral_m_per_s2=3.0,
        max_braking_m_per_s2=2.5,
        max_speeding_m_per_s2=2.0,
    ),
}


@dataclass(frozen=True)
class SimulationConfig:
    """A simulated drive through a procedural town. Equal configurations give equal bits.

    Attributes:
        shape: path of a lap: `circle`, `figure-eight`, `blocks`, or the name of a KITTI pose file whose plan is driven
            (laps, length_m, lateral_offset_m and reverse then do not apply).
        laps: number of laps, at least 1.
        length_m: length of one lap, metres.
        seed: seed of the town, the car's sway and the camera's noise.
        speed_m_per_s: speed of the car on a straight road, metres per second.
        frame_rate_hz: stereo pairs per second.
        width, height: image size, pixels; intrinsics scale from KITTI's 1241 x 376.
        lateral_offset_m: distance of later laps to the right of the first, metres.
        reverse: whether every second lap is driven in the opposite direction, in the other lane.
        change_illumination: whether later laps have another sun and sky.
        perceptual_aliasing: whether two streets, each a tenth of a lap, have houses of the same design in the same
            order and at the same distances; gardens, fences, awnings, posters, cars and trees still differ.
        cars_per_360m: oncoming cars on each 360 m, plus one car that drives ahead for a while; 0 for no cars.
        difficulty: `street`, as hard as real streets; `standard`, errors that an odometry can estimate and a car at
            constant speed; `clean`, that car with a perfect camera and without wind.
        rectification_error_px, lens_error_px: these errors, if not as the difficulty says.
        max_frames: largest number of frames; 0 for the whole drive.
        depth: whether to write depth maps of the left camera too (uint16 PNG, metres x 256, 0 = none).
    """

    shape: str = "circle"
    laps: int = 2
    length_m: float = 360.0
    seed: int = 0
    speed_m_per_s: float = 10.0
    frame_rate_hz: float = 10.0
    width: int = _KITTI_WIDTH
    height: int = _KITTI_HEIGHT
    lateral_offset_m: float = 0.0
    reverse: bool = False
    change_illumination: bool = False
    perceptual_aliasing: bool = False
    cars_per_360m: int = 6
    difficulty: str = "street"
    rectification_error_px: float | None = None
    lens_error_px: float | None = None
    max_frames: int = 0
    depth: bool = False

    shutter_s: ClassVar[float] = 0.005  # time that the shutter is open

    def __post_init__(self) -> None:
        if self.shape not in SHAPES and not Path(self.shape).is_file():
            raise ConfigError(
                f"shape {self.shape!r}: expected {', '.join(SHAPES)} or the path of a KITTI pose file, "
                "found neither; check the name"
            )
        if self.difficulty not in DIFFICULTIES:
            raise ConfigError(
                f"difficulty of a simulated drive: expected {', '.join(DIFFICULTIES)}, got {self.difficulty!r}"
            )
        check_ranges(self, _RANGES, "drive")

    @property
    def conditions(self) -> Difficulty:
        """What the difficulty stands for, with the errors that this configuration names itself."""
        return with_named_errors(DIFFICULTIES[self.difficulty], self)

    @property
    def from_file(self) -> bool:
        """Whether the path comes from a pose file."""
        return self.shape not in SHAPES

    @property
    def camera(self) -> "StereoCamera":
        """KITTI's camera scaled to this image size; the horizontal field of view stays."""
        from odometry.camera import StereoCamera

        scale = self.width / _KITTI_WIDTH
        # Pixel centres are whole numbers, so coordinates scale about (-0.5, -0.5), the corner of the image.
        cx = (_KITTI_CX + 0.5) * scale - 0.5
        cy = (_KITTI_CY + 0.5) / _KITTI_HEIGHT * self.height - 0.5
        focal = _KITTI_FOCAL * scale
        return StereoCamera(focal, focal, cx, cy, _KITTI_BASELINE, self.width, self.height)

    def rng(self, *purpose: int) -> "np.random.Generator":
        """Return the generator of one purpose, such as one frame's noise; it is independent of all others."""
        return random_generator(self.seed, *purpose)


def with_named_errors(level: Difficulty, config: object) -> Difficulty:
    """Return a difficulty with the errors that a configuration names itself."""
    named = {field.name: getattr(config, field.name, None) for field in fields(level)}
    return replace(level, **{name: value for name, value in named.items() if value is not None})


def random_generator(seed: int, *purpose: int) -> "np.random.Generator":
    """Return the generator of one purpose, such as one frame's noise; it is independent of all others."""
    import numpy as np

    return np.random.default_rng(np.random.SeedSequence([seed, *purpose]))


def check_ranges(config: object, ranges: Ranges, kind: str) -> None:
    """Check that fields of a configuration are finite and in their ranges, or None.

    Raises:
        ConfigError: one is not.
    """
    for name, low, high in ranges:
        value = getattr(config, name)
        if value is not None and not (math.isfinite(value) and low <= value <= high):
            raise ConfigError(f"{name} of a simulated {kind}: expected {low:g} to {high:g}, got {value:g}")


_RANGES: Ranges = (
    ("laps", 1, 1000),
    ("length_m", 150.0, 20000.0),
    ("seed", 0, 2**31),
    ("speed_m_per_s", 0.1, 40.0),
    ("frame_rate_hz", 0.1, 200.0),
    ("width", 32, 4096),
    ("height", 24, 4096),
    ("lateral_offset_m", -1.5, 1.5),
    ("cars_per_360m", 0, 100),
    ("rectification_error_px", 0.0, 5.0),
    ("lens_error_px", -50.0, 50.0),
    ("max_frames", 0, 10**7),
)
