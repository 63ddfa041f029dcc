"""Sensor model: turns light into grey values, with motion blur, defocus, calibration errors, exposure and noise."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from odometry.camera import StereoCamera
from slam.simulation.scenario.config import SimulationConfig

Buffer = NDArray[Any]  # read and written by compiled code, which takes any number type

Array = NDArray[np.float64]
Image = NDArray[np.float32]

_SHUTTER_S = 0.005  # time that the shutter is open
_DEFOCUS_PX = 0.5  # at KITTI's size: standard deviation of the blur of lens and rectification
_VIGNETTE = 0.22  # share of the light lost in a corner of the image
_READ_NOISE, _SHOT_NOISE = 1.1, 0.012  # standard deviation, grey values; variance per grey value
_TARGET_LIGHT, _REACTION = 0.36, 0.75  # mean light that the exposure control aims at, and the exponent of its reaction
_STEP_S = 9.0  # time between jumps of the exposure
_DECENTERING = 0.4  # share of the lens error that is decentering, not radial
_RIGHT_GAIN = 1.03  # brightness of the right camera relative to the left one: real pairs are never equal
_KITTI_WIDTH = 1241.0  # px, to which errors in pixels refer
_MAX_BLUR_PX, _MIN_BLUR_PX = 24.0, 0.6  # length of motion blur: longer is cut, shorter is invisible


@dataclass(frozen=True)
class SensorModel:
    """One camera of the pair, with its constant errors.

    Attributes:
        config: configuration of the dataset.
        side: 0 for the left camera, 1 for the right one.
        map_x, map_y: (H, W) where each pixel of the image with its calibration error is read, pixels.
        vignette: (H, W) factor on the light.
    """

    config: SimulationConfig
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
        if self.config.ideal_sensor:
            return _quantize(light * np.float32(255.0 * gain))
        camera = self.config.camera
        share = _SHUTTER_S * self.config.frame_rate_hz
        image = blur_motion(light, depth, (motion[:3] - np.eye(3, 4)) * share, intrinsics_of(camera))
        sigma = _DEFOCUS_PX * max(camera.width / _KITTI_WIDTH, 0.5)
        image = cv2.GaussianBlur(image, (0, 0), sigma) * self.vignette
        if self.config.rectification_error_px or self.config.lens_error_px:
            image = cv2.remap(image, self.map_x, self.map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        grey = image * np.float32(255.0 * gain * (1.0, _RIGHT_GAIN)[self.side])
        noise = self.config.rng(10, frame, self.side).standard_normal(grey.shape, dtype=np.float32)
        np.clip(grey, 0.0, 300.0, out=grey)
        return _quantize(grey + noise * np.sqrt(_READ_NOISE**2 + np.float32(_SHOT_NOISE) * grey))


def _quantize(grey: Image) -> NDArray[np.uint8]:
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def intrinsics_of(camera: StereoCamera) -> Array:
    """Return fx, fy, cx, cy (4,) for compiled code."""
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy])


def build_sensor_model(config: SimulationConfig, side: int) -> SensorModel:
    """Draw the constant errors of one camera at random: its own calibration error, and the lens error of both."""
    x, y = np.meshgrid(np.arange(config.width, dtype=np.float64), np.arange(config.height, dtype=np.float64))
    a, b = 2 * x / config.width - 1, 2 * y / config.height - 1
    shifts = _rectification_shifts(config, side, a, b) + _lens_shifts(config, x, y)
    vignette = 1.0 - _VIGNETTE * (a * a + 0.3 * b * b) / 1.3
    return SensorModel(
        config,
        side,
        (x + shifts[0]).astype(np.float32),
        (y + shifts[1]).astype(np.float32),
        vignette.astype(np.float32),
    )


def _rectification_shifts(config: SimulationConfig, side: int, a: Array, b: Array) -> Array:
    """Smooth shifts (2, H, W), pixels, up to half the rectification error; a and b run from -1 to 1 over the image."""
    terms = np.stack([np.ones_like(a), a, b, a * a, a * b, b * b, a * a * a])
    shifts = np.tensordot(config.rng(11, side).normal(size=(2, len(terms))), terms, axes=1)
    peak = 0.5 * config.rectification_error_px * config.width / _KITTI_WIDTH
    return np.asarray(shifts * peak / np.abs(shifts).max(axis=(1, 2), keepdims=True))


def _lens_shifts(config: SimulationConfig, x: Array, y: Array) -> Array:
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
    return np.stack([across, down]) * (config.lens_error_px * config.width / _KITTI_WIDTH)


def exposure_gain(config: SimulationConfig, light: Image, time: float) -> float:
    """Return the gain at a time, seconds: control towards a mean, slow drift, and a jump every few seconds."""
    if config.ideal_sensor:
        return 0.8
    controlled = (_TARGET_LIGHT / max(float(light.mean()), 1e-3)) ** _REACTION
    drift = 1.0 + 0.06 * np.sin(0.31 * time + config.seed) + 0.04 * np.sin(1.7 * time)
    step = config.rng(12, int(time / _STEP_S)).uniform(0.78, 1.28)
    return float(controlled * drift * step)


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
