"""From light to grey values: what lens, shutter, sensor and calibration do to an image."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from odometry.camera import StereoCamera
from slam.simulation.spec import DriveSpec

Buffer = NDArray[Any]  # read and written by compiled code, which takes any number type

Array = NDArray[np.float64]
Image = NDArray[np.float32]

_EXPOSURE = 0.005  # seconds the shutter is open
_DEFOCUS = 0.5  # pixels at KITTI's size, deviation of the blur of lens and rectification
_VIGNETTE = 0.22  # light lost in the far corner
_READ_NOISE, _SHOT_NOISE = 1.1, 0.012  # grey values; variance per grey value
_TARGET, _REACTION = 0.36, 0.75  # mean light the exposure control aims at, and how far it gets
_STEP_SECONDS = 9.0  # mean time between jumps of the exposure
_DECENTERING = 0.4  # of the lens error is not radial


@dataclass(frozen=True)
class Sensor:
    """One camera of the pair with the faults it keeps during the drive.

    Attributes:
        spec: of the drive.
        side: 0 left, 1 right.
        map_x, map_y: (H, W) where each pixel of the image with its calibration error is read, pixels.
        vignette: (H, W) factor.

    """

    spec: DriveSpec
    side: int
    map_x: Image
    map_y: Image
    vignette: Image

    def expose(self, light: Image, depth: Image, motion: Array, gain: float, frame: int) -> NDArray[np.uint8]:
        """Take the picture (H, W) uint8 of light and depth (H, W), metres.

        motion: (4, 4) T_now_next, to the camera one frame later; gain: grey value 255 per unit of light.
        """
        if self.spec.clean:
            return _quantised(light * np.float32(255.0 * gain))
        camera = self.spec.camera
        share = _EXPOSURE * self.spec.frame_rate
        image = smear(light, depth, (motion[:3] - np.eye(3, 4)) * share, camera_row(camera))
        sigma = _DEFOCUS * max(camera.width / 1241.0, 0.5)
        image = cv2.GaussianBlur(image, (0, 0), sigma) * self.vignette
        if self.spec.rectification_error or self.spec.lens_error:
            image = cv2.remap(image, self.map_x, self.map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        # The right camera of a real pair is never quite as bright as the left one.
        grey = image * np.float32(255.0 * gain * (1.0, 1.03)[self.side])
        noise = self.spec.rng(10, frame, self.side).standard_normal(grey.shape, dtype=np.float32)
        np.clip(grey, 0.0, 300.0, out=grey)
        return _quantised(grey + noise * np.sqrt(_READ_NOISE**2 + np.float32(_SHOT_NOISE) * grey))


def _quantised(grey: Image) -> NDArray[np.uint8]:
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def camera_row(camera: StereoCamera) -> Array:
    """Intrinsics (4,) fx, fy, cx, cy for compiled code."""
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy])


def build_sensor(spec: DriveSpec, side: int) -> Sensor:
    """Draw the lasting faults of one camera: its own calibration error, and the lens error that both share."""
    x, y = np.meshgrid(np.arange(spec.width, dtype=np.float64), np.arange(spec.height, dtype=np.float64))
    a, b = 2 * x / spec.width - 1, 2 * y / spec.height - 1
    shifts = _rectification_shifts(spec, side, a, b) + _lens_shifts(spec, x, y)
    vignette = 1.0 - _VIGNETTE * (a * a + 0.3 * b * b) / 1.3
    return Sensor(
        spec,
        side,
        (x + shifts[0]).astype(np.float32),
        (y + shifts[1]).astype(np.float32),
        vignette.astype(np.float32),
    )


def _rectification_shifts(spec: DriveSpec, side: int, a: Array, b: Array) -> Array:
    """Smooth shifts (2, H, W), pixels, up to half the rectification error; a and b run from -1 to 1 over the image."""
    terms = np.stack([np.ones_like(a), a, b, a * a, a * b, b * b, a * a * a])
    shifts = np.tensordot(spec.rng(11, side).normal(size=(2, len(terms))), terms, axes=1)
    peak = 0.5 * spec.rectification_error * spec.width / 1241.0
    return np.asarray(shifts * peak / np.abs(shifts).max(axis=(1, 2), keepdims=True))


def _lens_shifts(spec: DriveSpec, x: Array, y: Array) -> Array:
    """What calibration left of the lens's distortion (2, H, W), pixels (Brown, Decentering Distortion of Lenses, 1966).

    Radial, and decentering in a direction of its own. The same in both cameras, which are of one make: a pair
    cannot see it by comparing its two images, and so it turns into drift.
    """
    camera = spec.camera
    x, y = (x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy
    squared = x * x + y * y
    angle = spec.rng(13).uniform(0.0, 2.0 * np.pi)
    p, q = _DECENTERING * np.sin(angle), _DECENTERING * np.cos(angle)
    across = -squared * x + q * (squared + 2 * x * x) + 2 * p * x * y
    down = -squared * y + p * (squared + 2 * y * y) + 2 * q * x * y
    return np.stack([across, down]) * (spec.lens_error * spec.width / 1241.0)


def gain(spec: DriveSpec, light: Image, time: float) -> float:
    """Exposure of a moment: control towards a mean, slow drift, and a jump now and then."""
    if spec.clean:
        return 0.8
    controlled = (_TARGET / max(float(light.mean()), 1e-3)) ** _REACTION
    drift = 1.0 + 0.06 * np.sin(0.31 * time + spec.seed) + 0.04 * np.sin(1.7 * time)
    step = spec.rng(12, int(time / _STEP_SECONDS)).uniform(0.78, 1.28)
    return float(controlled * drift * step)


@njit(cache=True, nogil=True, error_model="numpy")
def smear(image: Buffer, depth: Buffer, step: Buffer, intrinsics: Buffer) -> Buffer:
    """Blur (H, W) along each pixel's own motion while the shutter is open.

    depth: (H, W) metres; step: (3, 4) change of the camera's pose in that time, less the identity;
        intrinsics: (4,).
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
            length = min(np.sqrt(u * u + v * v), 24.0)
            if length < 0.6:
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
