"""Configuration of a simulated dataset: it determines every pixel."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from odometry.camera import StereoCamera
from slam.errors import ConfigError

SHAPES = ("circle", "figure-eight", "blocks")
FORMAT = 2  # raised whenever the same configuration gives other files

# The camera of KITTI's first recording day, at its own image size.
_KITTI_WIDTH, _KITTI_HEIGHT = 1241, 376
_KITTI_FOCAL, _KITTI_CX, _KITTI_CY, _KITTI_BASELINE = 718.856, 607.1928, 185.2157, 0.54


@dataclass(frozen=True)
class SimulationConfig:
    """A simulated drive through a procedural town. Equal configurations give equal bits.

    Attributes:
        shape: path of a lap: `circle`, `figure-eight`, `blocks`, or the name of a KITTI pose file whose plan is driven
            (laps, length_m, lateral_offset_m and reverse then do not apply).
        laps: number of laps, at least 1.
        length_m: length of one lap, metres.
        seed: seed of the town, the car's sway and the camera's noise.
        speed_m_per_s: speed of the car, metres per second.
        frame_rate_hz: stereo pairs per second.
        width, height: image size, pixels; intrinsics scale from KITTI's 1241 x 376.
        lateral_offset_m: distance of later laps to the right of the first, metres.
        reverse: whether every second lap is driven in the opposite direction, in the other lane.
        change_illumination: whether later laps have another sun and sky.
        perceptual_aliasing: whether two streets, each a tenth of a lap, have houses of the same design in the same
            order and at the same distances; gardens, fences, awnings, posters, cars and trees still differ.
        cars_per_360m: oncoming cars on each 360 m, plus one car that drives ahead for a while; 0 for no cars.
        rectification_error_px: peak difference between the images and their calibration, pixels at KITTI's size.
        lens_error_px: distortion that the calibration has left, pixels at 45 degrees off the axis, at KITTI's size.
            The values of real pairs, from which both defaults come: docs/decisions/simulation_rendering.md.
        max_frames: largest number of frames; 0 for the whole drive.
        ideal_sensor: whether to leave out noise, blur, vignetting, calibration errors, exposure changes and wind.
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
    rectification_error_px: float = 0.6
    lens_error_px: float = 12.0
    max_frames: int = 0
    ideal_sensor: bool = False
    depth: bool = False

    def __post_init__(self) -> None:
        if self.shape not in SHAPES and not Path(self.shape).is_file():
            raise ConfigError(
                f"shape {self.shape!r}: expected {', '.join(SHAPES)} or the path of a KITTI pose file, "
                "found neither; check the name"
            )
        for name, low, high in _RANGES:
            value = getattr(self, name)
            if not (math.isfinite(value) and low <= value <= high):
                raise ConfigError(f"{name} of a simulated drive: expected {low:g} to {high:g}, got {value:g}")

    @property
    def spacing_m(self) -> float:
        """Distance between two frames, metres."""
        return self.speed_m_per_s / self.frame_rate_hz

    @property
    def from_file(self) -> bool:
        """Whether the path comes from a pose file."""
        return self.shape not in SHAPES

    @property
    def camera(self) -> StereoCamera:
        """KITTI's camera scaled to this image size; the horizontal field of view stays."""
        scale = self.width / _KITTI_WIDTH
        # Pixel centres are whole numbers, so coordinates scale about (-0.5, -0.5), the corner of the image.
        cx = (_KITTI_CX + 0.5) * scale - 0.5
        cy = (_KITTI_CY + 0.5) / _KITTI_HEIGHT * self.height - 0.5
        focal = _KITTI_FOCAL * scale
        return StereoCamera(focal, focal, cx, cy, _KITTI_BASELINE, self.width, self.height)

    def rng(self, *purpose: int) -> np.random.Generator:
        """Return the generator of one purpose, such as one frame's noise; it is independent of all others."""
        return np.random.default_rng(np.random.SeedSequence([self.seed, *purpose]))


_RANGES: tuple[tuple[str, float, float], ...] = (
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
