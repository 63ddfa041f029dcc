"""Depth images as a structured-light camera gives them: noise, steps of disparity, shadows, and holes.

Noise grows with the square of the distance (Khoshelham and Oude Elberink, Accuracy and resolution of Kinect depth data,
2012); disparity comes in eighths of a pixel.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from odometry.camera import StereoCamera

Image = NDArray[np.float32]

DEPTH_SCALE = 5000.0  # stored depth per metre, as in the TUM benchmark
MIN_DEPTH_M, MAX_DEPTH_M = 0.4, 5.0
SIGMA_PER_M2 = 0.0015  # standard deviation at one metre, metres
BASELINE_M, FOCAL_PX = 0.075, 525.0  # between projector and camera, and of the camera
_STEPS_PER_PX = 8.0  # of disparity
_MIN_COSINE = 0.17  # between ray and normal: 80 degrees from it nothing returns
_EDGE_SHARE = 0.04  # step between neighbours, as a share of the depth, at which the pixel shows neither surface


def measure_depth(depth: Image, returns: NDArray[np.bool_], camera: StereoCamera, rng: np.random.Generator) -> Image:
    """Return the depth (H, W) that the sensor measures, metres, 0 where it measures none.

    Args:
        depth: (H, W) true depth, metres; infinite where there is nothing.
        returns: (H, W) whether the surface returns infrared light.
        camera: intrinsics.
        rng: generator of the noise.
    """
    product = BASELINE_M * FOCAL_PX
    with np.errstate(divide="ignore"):
        disparity = np.where(np.isfinite(depth), product / depth, 0.0).astype(np.float32)
    noise = np.float32(SIGMA_PER_M2 * product) * rng.standard_normal(depth.shape, dtype=np.float32)
    steps = np.rint((disparity + noise) * _STEPS_PER_PX)
    with np.errstate(divide="ignore"):
        measured = np.where(steps > 0, product * _STEPS_PER_PX / steps, np.inf)
    seen = returns & (measured >= MIN_DEPTH_M) & (measured <= MAX_DEPTH_M)
    seen &= ~_is_in_shadow(disparity, camera) & ~_is_at_edge(depth) & (_cosine(depth, camera) > _MIN_COSINE)
    return np.where(seen, measured, 0.0).astype(np.float32)


def encode_depth(depth: Image, scale: float = DEPTH_SCALE) -> NDArray[np.uint16]:
    """Encode depth, metres, in units of 1 / scale; 0 for none and for depths beyond 16 bits."""
    scaled = np.rint(depth * scale)
    return np.where(scaled < 2**16, scaled, 0).astype(np.uint16)


def _is_in_shadow(disparity: Image, camera: StereoCamera) -> NDArray[np.bool_]:
    """Pixels (H, W) that the projector, to the right of the camera, does not reach, as nearer surfaces are between."""
    column = np.arange(disparity.shape[1], dtype=np.float32)[None, :]
    projected = column - disparity * np.float32(camera.fx / FOCAL_PX)
    nearest = np.minimum.accumulate(projected[:, ::-1], axis=1)[:, ::-1]
    return np.asarray(projected > nearest)


def _is_at_edge(depth: Image) -> NDArray[np.bool_]:
    """Pixels (H, W) next to a step of depth."""
    near, far = cv2.erode(depth, np.ones((3, 3))), cv2.dilate(np.where(np.isfinite(depth), depth, 1e3), np.ones((3, 3)))
    return np.asarray(far - near > _EDGE_SHARE * near + 0.02)


def _cosine(depth: Image, camera: StereoCamera) -> Image:
    """Cosine (H, W) of the angle between ray and normal: a plane's 1/z is a x + b y + c, and (a, b, c) its normal."""
    with np.errstate(divide="ignore"):
        inverse = np.where(np.isfinite(depth), 1.0 / depth, 0.0)
    a, b = np.gradient(inverse, axis=1) * camera.fx, np.gradient(inverse, axis=0) * camera.fy
    x = (np.arange(camera.width) - camera.cx)[None, :] / camera.fx
    y = (np.arange(camera.height) - camera.cy)[:, None] / camera.fy
    c = inverse - a * x - b * y
    length = np.sqrt((a * a + b * b + c * c) * (x * x + y * y + 1.0))
    return np.asarray(np.abs(inverse) / np.maximum(length, 1e-9), dtype=np.float32)
