"""Scenes whose depth is known: textured planes seen by a pair."""

import cv2
import numpy as np

from odometry import se3
from odometry.camera import StereoCamera
from slam.mapping.dense_stereo import DepthImage, as_color

CAMERA = StereoCamera(359.4, 359.4, 309.5, 93.5, 0.54, 620, 188)
CAMERA_HEIGHT = 1.71  # metres, and no multiple of a voxel, where the sign of a distance is a matter of rounding


def rays(camera: StereoCamera) -> np.ndarray:
    """Directions (H, W, 3) of all pixels, z = 1."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    return np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=2)


def plane_depth(camera: StereoCamera, T_world_camera: np.ndarray, normal: np.ndarray, offset: float) -> np.ndarray:
    """Depth (H, W) of the plane normal . p = offset in the world; infinite where it is not seen."""
    R, t = T_world_camera[:3, :3], T_world_camera[:3, 3]
    with np.errstate(divide="ignore"):
        depth = (offset - normal @ t) / (rays(camera) @ (R.T @ normal))
    return np.where(depth > 0, depth, np.inf)


def street(camera: StereoCamera, T_world_camera: np.ndarray) -> np.ndarray:
    """Depth (H, W) of a road below the world's first camera, and a wall 4 m to its left, 3 m high."""
    road = plane_depth(camera, T_world_camera, np.array([0.0, 1.0, 0.0]), CAMERA_HEIGHT)
    wall = plane_depth(camera, T_world_camera, np.array([1.0, 0.0, 0.0]), -4.0)
    with np.errstate(invalid="ignore"):
        down = (rays(camera) @ T_world_camera[:3, :3].T)[..., 1] * wall + T_world_camera[1, 3]
    return np.minimum(road, np.where(down > CAMERA_HEIGHT - 3.0, wall, np.inf))


def seen(T_world_camera: np.ndarray, max_depth: float = 25.0) -> DepthImage:
    """What a perfect depth camera sees of the street; grey is the row."""
    depth = street(CAMERA, T_world_camera)
    grey = np.repeat(np.arange(CAMERA.height, dtype=np.uint8)[:, None], CAMERA.width, axis=1)
    return DepthImage(np.where(depth < max_depth, depth, 0).astype(np.float32), as_color(grey), CAMERA)


def ahead(*metres: float) -> np.ndarray:
    """Poses (K, 4, 4) along z."""
    return np.array([se3.pose(np.eye(3), np.array([0.0, 0.0, z])) for z in metres])


def photographed(camera: StereoCamera, disparity: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Photograph a textured wall across the view, at one disparity (pixels)."""
    texture = cv2.GaussianBlur(rng.uniform(0, 255, (camera.height, camera.width + 200)), (0, 0), 2.0)
    texture = cv2.normalize(texture, None, 20, 235, cv2.NORM_MINMAX).astype(np.float32)
    u, v = np.meshgrid(np.arange(camera.width, dtype=np.float32), np.arange(camera.height, dtype=np.float32))
    left, right = (cv2.remap(texture, u + shift, v, cv2.INTER_CUBIC) for shift in (100.0, 100.0 + disparity))
    return left.astype(np.uint8), right.astype(np.uint8)
