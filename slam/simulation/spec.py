"""What a simulated drive is: one frozen description from which every pixel follows."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from odometry.camera import StereoCamera
from slam.errors import ConfigError

SHAPES = ("circle", "figure-eight", "blocks")
FORMAT = 1  # raised whenever the same spec would give other files

# The camera of KITTI's first recording day, at its own image size.
_KITTI_WIDTH, _KITTI_HEIGHT = 1241, 376
_KITTI_FOCAL, _KITTI_CX, _KITTI_CY, _KITTI_BASELINE = 718.856, 607.1928, 185.2157, 0.54


@dataclass(frozen=True)
class DriveSpec:
    """A drive through a procedural town; equal specs give equal bits.

    Attributes:
        shape: `circle`, `figure-eight`, `blocks`, or the path of a KITTI pose file whose plan is driven at
            this speed (laps, length, lateral_offset and reverse then do not apply).
        laps: times the shape is driven, at least 1.
        length: way of one lap, metres.
        seed: of the town, the car's sway and the camera's noise.
        speed: of the car, metres a second.
        frame_rate: stereo pairs a second.
        width, height: image size, pixels; intrinsics scale from KITTI's 1241 x 376.
        lateral_offset: how far later laps drive to the right of the first, metres.
        reverse: every second lap drives the opposite way, in the other lane.
        relight: later laps see another sun and sky.
        alike: two streets, each a tenth of a lap, have houses of the same design, in the same order and at the same
            distances; gardens, fences, awnings, posters, cars and trees are each street's own.
        moving_cars: cars met a lap of 360 m, and one that drives ahead for a while; 0 for none.
        rectification_error: peak disagreement of the images with their calibration, pixels at KITTI's size;
            real KITTI pairs show 0.1 to 0.9 between columns and up to 1.2 between rows.
        lens_error: distortion that calibration has left, pixels at 45 degrees off the axis, at KITTI's size. The
            likelihood of what stereo odometry tracks on real KITTI clips favours 6 to 20 of it. With the default a
            plain odometry drifts 0.5 to 1.8 % of the way (seeds 0 to 2), on the clips 05 and 06 2.1 and 1.3 %.
        max_frames: stop after so many frames; 0 for the whole drive.
        clean: leave out noise, blur, vignetting, calibration errors, exposure changes and wind.
        depth: also write depth maps of the left camera (uint16 PNG, metres x 256, 0 = none).

    """

    shape: str = "circle"
    laps: int = 2
    length: float = 360.0
    seed: int = 0
    speed: float = 10.0
    frame_rate: float = 10.0
    width: int = _KITTI_WIDTH
    height: int = _KITTI_HEIGHT
    lateral_offset: float = 0.0
    reverse: bool = False
    relight: bool = False
    alike: bool = False
    moving_cars: int = 6
    rectification_error: float = 0.6
    lens_error: float = 12.0
    max_frames: int = 0
    clean: bool = False
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
    def spacing(self) -> float:
        """Way between two frames, metres."""
        return self.speed / self.frame_rate

    @property
    def from_file(self) -> bool:
        """Whether the way comes from a pose file."""
        return self.shape not in SHAPES

    @property
    def camera(self) -> StereoCamera:
        """KITTI's camera scaled to this image size; the horizontal field of view stays."""
        scale = self.width / _KITTI_WIDTH
        # Pixel centres are whole numbers, so a scaled principal point moves by half a pixel of difference.
        cx = (_KITTI_CX + 0.5) * scale - 0.5
        cy = (_KITTI_CY + 0.5) / _KITTI_HEIGHT * self.height - 0.5
        focal = _KITTI_FOCAL * scale
        return StereoCamera(focal, focal, cx, cy, _KITTI_BASELINE, self.width, self.height)

    def rng(self, *purpose: int) -> np.random.Generator:
        """Random numbers of their own for a purpose, say one frame's noise, whatever was drawn elsewhere."""
        return np.random.default_rng(np.random.SeedSequence([self.seed, *purpose]))


_RANGES: tuple[tuple[str, float, float], ...] = (
    ("laps", 1, 1000),
    ("length", 150.0, 20000.0),
    ("seed", 0, 2**31),
    ("speed", 0.1, 40.0),
    ("frame_rate", 0.1, 200.0),
    ("width", 32, 4096),
    ("height", 24, 4096),
    ("lateral_offset", -1.5, 1.5),
    ("moving_cars", 0, 100),
    ("rectification_error", 0.0, 5.0),
    ("lens_error", -50.0, 50.0),
    ("max_frames", 0, 10**7),
)
