"""Sensor model: turns light into grey values, with motion blur, defocus, calibration errors, exposure and noise."""

from dataclasses import dataclass
from typing import Any, Protocol

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from odometry.camera import StereoCamera
from slam.simulation.scenario.config import Difficulty

Buffer = NDArray[Any]  # read and written by compiled code, which takes any number type

Array = NDArray[np.float64]
Image = NDArray[np.float32]

_DEFOCUS_PX = 0.5  # at KITTI's size: standard deviation of the blur of lens and rectification
_VIGNETTE = 0.22  # share of the light lost in a corner of the image
_READ_NOISE, _SHOT_NOISE = 1.1, 0.012  # standard deviation, grey values; variance per grey value
_TARGET_LIGHT, _REACTION = 0.36, 0.75  # mean light that the exposure control aims at, and the exponent of its reaction
_STEP_S = 9.0  # time between jumps of the exposure
_DECENTERING = 0.4  # share of the lens error that is decentering, not radial
_LOCAL_ROWS, _LOCAL_COLUMNS = 4, 9  # nodes of the error that no model of a lens describes
_RIG_HERTZ = (0.02, 1.0)  # slowest and fastest oscillation of the rig, by heat and by shaking
_RIG_WAVES = 6
_RIGHT_GAIN = 1.03  # brightness of the right camera relative to the left one: real pairs are never equal
_KITTI_WIDTH = 1241.0  # px, to which errors in pixels refer
_MAX_BLUR_PX, _MIN_BLUR_PX = 24.0, 0.6  # length of motion blur: longer is cut, shorter is invisible


class SensorConfig(Protocol):
    """What the sensor model must know of a simulated drive or room."""

    @property
    def seed(self) -> int:
        """Seed of all random generators."""

    @property
    def width(self) -> int:
        """Image width, pixels."""

    @property
    def height(self) -> int:
        """Image height, pixels."""

    @property
    def frame_rate_hz(self) -> float:
        """Images per second."""

    @property
    def shutter_s(self) -> float:
        """Time that the shutter is open, seconds."""

    @property
    def conditions(self) -> Difficulty:
        """Errors of the camera."""

    @property
    def camera(self) -> StereoCamera:
        """The camera as its calibration describes it."""

    def rng(self, *purpose: int) -> np.random.Generator:
        """Return the generator of one purpose."""


@dataclass(frozen=True)
class SensorModel:
    """One camera of the pair, with its constant errors.

    Attributes:
        config: configuration of the dataset.
        side: 0 for the left camera, 1 for the right one.
        map_x, map_y: (H, W) where each pixel of the image with its calibration error is read, pixels, before the rig
            moves.
        vignette: (H, W) factor on the light.
    """

    config: SensorConfig
    side: int
    map_x: Image
    map_y: Image
    vignette: Image

    def expose(self, light: Image, depth: Image, motion: Array, gain: float, frame: int) -> NDArray[np.uint8]:
        """Return the image (H, W) uint8.

        Args:
            light: (H, W) light that reaches the lens.
            depth: (H, W) metres.
            motion: (4, 4) T_now_next, pose of the camera one frame later in its present frame, metres.
            gain: brightness of the image per unit of light; 1 maps light 1 to grey value 255.
            frame: number of the frame, which the noise depends on.
        """
        real, side = self.config.conditions.real_sensor, self.side
        image = self.displace(self._blur(light, depth, motion) if real else light, frame)
        grey = image * np.float32(255.0 * gain * _own_gain(self.config, side, frame))
        if not real:
            return _quantize(grey)
        noise = self.config.rng(10, frame, side).standard_normal(grey.shape, dtype=np.float32)
        np.clip(grey, 0.0, 300.0, out=grey)
        return _quantize(grey + noise * np.sqrt(_READ_NOISE**2 + np.float32(_SHOT_NOISE) * grey))

    def _blur(self, light: Image, depth: Image, motion: Array) -> Image:
        """Return the light after motion blur, defocus and vignetting."""
        camera = self.config.camera
        share = self.config.shutter_s * self.config.frame_rate_hz
        image = blur_motion(light, depth, (motion[:3] - np.eye(3, 4)) * share, intrinsics_of(camera))
        sigma = _DEFOCUS_PX * max(camera.width / _KITTI_WIDTH, 0.5)
        return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma) * self.vignette)

    def displace(self, image: Image, frame: int, interpolation: int = cv2.INTER_LINEAR) -> Image:
        """Return the image as the camera shows it, which is not as its calibration says."""
        if not _has_calibration_error(self.config.conditions):
            return image
        columns, rows = _rig_shifts(self.config, self.side, frame, image.shape)
        return cv2.remap(image, self.map_x + columns, self.map_y + rows, interpolation, borderMode=cv2.BORDER_REFLECT)


def _has_calibration_error(level: Difficulty) -> bool:
    errors = (level.rectification_error_px, level.lens_error_px, level.local_error_px)
    return any((*errors, level.focal_error_percent, level.principal_point_error_px, level.rig_drift_px))


def _quantize(grey: Image) -> NDArray[np.uint8]:
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def intrinsics_of(camera: StereoCamera) -> Array:
    """Return fx, fy, cx, cy (4,) for compiled code."""
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy])


def build_sensor_model(config: SensorConfig, side: int) -> SensorModel:
    """Draw the constant errors of one camera at random: its own calibration error, and the lens error of both."""
    x, y = np.meshgrid(np.arange(config.width, dtype=np.float64), np.arange(config.height, dtype=np.float64))
    a, b = 2 * x / config.width - 1, 2 * y / config.height - 1
    shifts = _rectification_shifts(config, side, a, b) + _lens_shifts(config, x, y)
    shifts += _local_shifts(config, side) + _intrinsic_shifts(config, x, y)
    vignette = 1.0 - _VIGNETTE * (a * a + 0.3 * b * b) / 1.3
    return SensorModel(
        config,
        side,
        (x + shifts[0]).astype(np.float32),
        (y + shifts[1]).astype(np.float32),
        vignette.astype(np.float32),
    )


def _rectification_shifts(config: SensorConfig, side: int, a: Array, b: Array) -> Array:
    """Smooth shifts (2, H, W), pixels, up to half the rectification error; a and b run from -1 to 1 over the image."""
    terms = np.stack([np.ones_like(a), a, b, a * a, a * b, b * b, a * a * a])
    shifts = np.tensordot(config.rng(11, side).normal(size=(2, len(terms))), terms, axes=1)
    peak = 0.5 * config.conditions.rectification_error_px * config.width / _KITTI_WIDTH
    return np.asarray(shifts * peak / np.abs(shifts).max(axis=(1, 2), keepdims=True))


def _lens_shifts(config: SensorConfig, x: Array, y: Array) -> Array:
    """Shifts (2, H, W), pixels, by distortion that the calibration has left.

    Radial distortion, and decentering in a random direction (Brown, Decentering Distortion of Lenses, 1966). Both
    cameras have the same, as two of one make: the error is not visible in a comparison of left and right images, and so
    it causes drift.
    """
    camera = config.camera
    x, y = (x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy
    squared = x * x + y * y
    angle = config.rng(13).uniform(0.0, 2.0 * np.pi)
    p, q = _DECENTERING * np.sin(angle), _DECENTERING * np.cos(angle)
    across = -squared * x + q * (squared + 2 * x * x) + 2 * p * x * y
    down = -squared * y + p * (squared + 2 * y * y) + 2 * q * x * y
    return np.stack([across, down]) * (config.conditions.lens_error_px * config.width / _KITTI_WIDTH)


def _local_shifts(config: SensorConfig, side: int) -> Array:
    """Shifts (2, H, W), pixels, by what no polynomial describes: a field with about four hills across the image."""
    nodes = config.rng(14, side).standard_normal((2, _LOCAL_ROWS, _LOCAL_COLUMNS), dtype=np.float32)
    size = (config.width, config.height)
    field = np.stack([cv2.resize(axis, size, interpolation=cv2.INTER_CUBIC) for axis in nodes])
    rms = np.sqrt(np.mean(np.square(field), axis=(1, 2), keepdims=True))
    return np.asarray(field * (config.conditions.local_error_px * config.width / _KITTI_WIDTH) / rms)


def _intrinsic_shifts(config: SensorConfig, x: Array, y: Array) -> Array:
    """Shifts (2, H, W), pixels, by the errors of focal length and principal point.

    Both cameras have the same: rectification gives them one camera matrix, and what differs between them would be seen
    in a comparison of their images.
    """
    camera, level, rng = config.camera, config.conditions, config.rng(15)
    longer = 1.0 + rng.choice([-1.0, 1.0]) * level.focal_error_percent / 100.0
    angle = rng.uniform(0.0, 2.0 * np.pi)
    distance = level.principal_point_error_px * config.width / _KITTI_WIDTH
    cx, cy = camera.cx + distance * np.cos(angle), camera.cy + distance * np.sin(angle)
    return np.stack([(x - cx) / longer + camera.cx - x, (y - cy) / longer + camera.cy - y])


def _rig_shifts(config: SensorConfig, side: int, frame: int, shape: tuple[int, ...]) -> tuple[Image, Image]:
    """Shifts of columns and rows, pixels, by the movement of the right camera since its calibration.

    The rotations about its three axes wander as sums of oscillations, which depend on the time alone.
    """
    height, width = shape
    amplitude = side * config.conditions.rig_drift_px * width / _KITTI_WIDTH
    rng, time = config.rng(16), frame / config.frame_rate_hz
    hertz = np.geomspace(*_RIG_HERTZ, _RIG_WAVES)[:, None] * rng.uniform(0.8, 1.25, (_RIG_WAVES, 3))
    waves = np.sin(2 * np.pi * (hertz * time + rng.uniform(0.0, 1.0, (_RIG_WAVES, 3))))
    yaw, pitch, roll = amplitude * np.sqrt(2 / _RIG_WAVES) * waves.sum(axis=0)
    a, b = 2 * np.arange(width) / width - 1, (2 * np.arange(height) - height) / width
    columns, rows = yaw - roll * b[:, None], pitch + roll * a[None, :]
    return columns.astype(np.float32), rows.astype(np.float32)


def exposure_gain(config: SensorConfig, light: Image, time: float) -> float:
    """Return the gain at a time, seconds: control towards a mean, slow drift, and a jump every few seconds."""
    if not config.conditions.real_sensor:
        return 0.8
    controlled = (_TARGET_LIGHT / max(float(light.mean()), 1e-3)) ** _REACTION
    drift = 1.0 + 0.06 * np.sin(0.31 * time + config.seed) + 0.04 * np.sin(1.7 * time)
    step = config.rng(12, int(time / _STEP_S)).uniform(0.78, 1.28)
    return float(controlled * drift * step)


def _own_gain(config: SensorConfig, side: int, frame: int) -> float:
    """Brightness of one camera's image relative to what both would show, which the exposure of each alone decides."""
    level = config.conditions
    jitter = level.exposure_jitter_percent / 100.0 * config.rng(17, frame, side).standard_normal()
    return float((_RIGHT_GAIN if level.real_sensor and side else 1.0) * np.exp(jitter))


@njit(cache=True, nogil=True, error_model="numpy")
def blur_motion(image: Buffer, depth: Buffer, step: Buffer, intrinsics: Buffer) -> Buffer:
    """Return the image (H, W) blurred along each pixel's motion while the shutter is open.

    Args:
        image: (H, W) light.
        depth: (H, W) metres.
        step: (3, 4) change of the camera's pose in that time minus the identity: small rotation and translation.
        intrinsics: (4,) fx, fy, cx, cy, pixels.
    """
    height, width = image.shape
    fx, fy, cx, cy = intrinsics
    out = np.empty_like(image)
    for row in range(height):
        for column in range(width):
            x, y, z = (column - cx) / fx, (row - cy) / fy, depth[row, column]
            # A small motion moves the point against it: p' = p - (W p + t), seen from the later camera.
            dx = -(step[0, 0] * x + step[0, 1] * y + step[0, 2] + step[0, 3] / z)
            dy = -(step[1, 0] * x + step[1, 1] * y + step[1, 2] + step[1, 3] / z)
            dz = -(step[2, 0] * x + step[2, 1] * y + step[2, 2] + step[2, 3] / z)
            u, v = fx * (dx - x * dz), fy * (dy - y * dz)
            length = min(np.sqrt(u * u + v * v), _MAX_BLUR_PX)
            if length < _MIN_BLUR_PX:
                out[row, column] = image[row, column]
                continue
            taps = int(length + 1.6)
            total = 0.0
            for k in range(taps):
                t = (k + 0.5) / taps - 0.5
                a = min(max(column + t * u, 0.0), width - 1.001)
                b = min(max(row + t * v, 0.0), height - 1.001)
                i, j = int(a), int(b)
                a, b = a - i, b - j
                low = image[j, i] * (1 - a) + image[j, i + 1] * a
                total += low * (1 - b) + (image[j + 1, i] * (1 - a) + image[j + 1, i + 1] * a) * b
            out[row, column] = total / taps
    return out
