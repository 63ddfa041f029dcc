"""Configuration of a simulated room: it determines every pixel."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from slam.errors import ConfigError
from slam.simulation.scenario.config import Difficulty, Ranges, check_ranges, random_generator, with_named_errors

if TYPE_CHECKING:
    import numpy as np

    from odometry.camera import StereoCamera

ROOM = "room"  # the word in place of the shape of a route
MOTIONS = ("hand", "robot")
SENSORS = ("mono", "stereo", "depth")
ROOM_FORMAT = 2  # raised whenever the same configuration gives other files

# The depth cameras of the TUM benchmark: 640 x 480 pixels, 525 pixels of focal length.
_WIDTH, _HEIGHT, _FOCAL = 640, 480, 525.0
_BASELINE_M = 0.11

# What calibration leaves in a camera for rooms is less than in one for cars, and `street` has been measured on cars.
ROOM_DIFFICULTIES = {
    "clean": Difficulty(),
    "standard": Difficulty(True, rectification_error_px=0.6, lens_error_px=4.0),
}


@dataclass(frozen=True)
class RoomConfig:
    """A camera that moves through a furnished room and its corridor. Equal configurations give equal bits.

    Attributes:
        seed: seed of the room, of the motion and of the camera's noise.
        motion: `hand`, a camera that somebody carries about; `robot`, one on a robot that drives and turns on the spot.
        sensor: `mono`, one camera; `stereo`, a rectified pair; `depth`, one camera with a depth camera.
        duration_s: length of the sequence, seconds.
        pure_rotation_s: seconds in the middle in which a carried camera turns without moving.
        frame_rate_hz: images, or pairs, per second.
        width, height: image size, pixels; intrinsics scale from 640 x 480.
        difficulty: `standard`, noise, motion blur, exposure and errors of calibration; `clean`, a perfect camera.
        rectification_error_px, lens_error_px: these errors at KITTI's image size, if not as the difficulty says.
        max_frames: largest number of frames; 0 for the whole sequence.
    """

    seed: int = 0
    motion: str = "hand"
    sensor: str = "depth"
    duration_s: float = 60.0
    pure_rotation_s: float = 0.0
    frame_rate_hz: float = 30.0
    width: int = _WIDTH
    height: int = _HEIGHT
    difficulty: str = "standard"
    rectification_error_px: float | None = None
    lens_error_px: float | None = None
    max_frames: int = 0

    shutter_s: ClassVar[float] = 0.01  # time that the shutter is open: indoors there is less light

    def __post_init__(self) -> None:
        for name, known in (("motion", MOTIONS), ("sensor", SENSORS), ("difficulty", tuple(ROOM_DIFFICULTIES))):
            if getattr(self, name) not in known:
                raise ConfigError(
                    f"{name} of a simulated room: expected {', '.join(known)}, got {getattr(self, name)!r}"
                )
        check_ranges(self, _RANGES, "room")
        if self.pure_rotation_s and self.motion != "hand":
            raise ConfigError("pure_rotation_s of a simulated room: expected 0, as a robot turns on the spot anyway; "
                              "leave it out or use the motion hand")  # fmt: skip
        if self.pure_rotation_s > self.duration_s / 2:
            raise ConfigError(
                f"pure_rotation_s of a simulated room: expected at most half of the duration, {self.duration_s / 2:g},"
                f" got {self.pure_rotation_s:g}"
            )

    @property
    def conditions(self) -> Difficulty:
        """What the difficulty stands for, with the errors that this configuration names itself."""
        return with_named_errors(ROOM_DIFFICULTIES[self.difficulty], self)

    @property
    def camera(self) -> "StereoCamera":
        """The camera at this image size; the horizontal field of view stays."""
        from odometry.camera import StereoCamera

        scale = self.width / _WIDTH
        focal = _FOCAL * scale
        return StereoCamera(
            focal, focal, self.width / 2 - 0.5, self.height / 2 - 0.5, _BASELINE_M, self.width, self.height
        )

    @property
    def frames(self) -> int:
        """Number of frames."""
        count = max(2, round(self.duration_s * self.frame_rate_hz))
        return min(count, self.max_frames) if self.max_frames else count

    def rng(self, *purpose: int) -> "np.random.Generator":
        """Return the generator of one purpose, such as one frame's noise; it is independent of all others."""
        return random_generator(self.seed, *purpose)


_RANGES: Ranges = (
    ("seed", 0, 2**31),
    ("duration_s", 1.0, 3600.0),
    ("pure_rotation_s", 0.0, 600.0),
    ("frame_rate_hz", 1.0, 200.0),
    ("width", 32, 4096),
    ("height", 24, 4096),
    ("rectification_error_px", 0.0, 5.0),
    ("lens_error_px", -50.0, 50.0),
    ("max_frames", 0, 10**7),
)
