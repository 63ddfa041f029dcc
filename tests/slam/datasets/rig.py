"""A world whose images can be taken with any lens: what a rig of two cameras sees of two textured walls, exactly."""

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from odometry import se3
from slam.datasets.distortion_models import FISHEYE_MODELS, CameraModel

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

SIZE = (320, 240)
TEXEL = 0.06  # m


@dataclass(frozen=True)
class Rig:
    """Two cameras.

    Attributes:
        left, right: lenses.
        T_left_right: (4, 4) pose of the right camera in the left one, metres.
    """

    left: CameraModel
    right: CameraModel
    T_left_right: Array = field(default_factory=lambda: se3.pose(np.eye(3), np.array([0.3, 0.0, 0.0])))


def turned(degrees: tuple[float, float, float], t: tuple[float, float, float]) -> Array:
    """Pose (4, 4) by rotation vector, degrees, and position, metres."""
    return se3.pose(Rotation.from_rotvec(degrees, degrees=True).as_matrix(), np.array(t))


IDEAL = Rig(CameraModel(260.0, 260.0, 160.0, 118.0), CameraModel(260.0, 260.0, 160.0, 118.0))
RIGS = {
    "ideal": IDEAL,
    "radtan": Rig(
        CameraModel(200.0, 201.0, 163.0, 117.0, "radtan", (-0.28, 0.074, 0.0002, 0.00002)),
        CameraModel(199.0, 198.5, 156.0, 121.0, "radtan", (-0.283, 0.074, -0.0001, -0.00003)),
        turned((0.4, 0.9, -0.6), (0.11, -0.002, 0.001)),
    ),
    "rational": Rig(
        CameraModel(210.0, 210.0, 160.0, 120.0, "rational", (0.3, -0.1, 0.001, -0.001, 0.02, 0.62, -0.05, 0.01)),
        CameraModel(211.0, 211.0, 158.0, 122.0, "rational", (0.31, -0.1, 0.0, 0.001, 0.02, 0.63, -0.05, 0.01)),
        turned((-1.0, 1.5, 0.5), (0.2, 0.01, -0.01)),
    ),
    "fisheye": Rig(
        CameraModel(105.0, 105.0, 160.0, 121.0, "equidistant", (0.003, 0.0007, -0.002, 0.0002)),
        CameraModel(105.5, 105.2, 157.0, 119.0, "equidistant", (0.002, 0.001, -0.002, 0.0003)),
        turned((0.5, -1.2, 1.0), (0.1, 0.001, 0.002)),
    ),
    "mixed": Rig(
        CameraModel(200.0, 201.0, 163.0, 117.0, "radtan", (-0.28, 0.074, 0.0002, 0.00002, 0.0)),
        CameraModel(205.0, 205.0, 160.0, 120.0),
        turned((0.0, 2.0, 0.0), (0.25, 0.0, 0.0)),
    ),
}


class Walls:
    """Two walls across the view, the nearer one on the left."""

    def __init__(self, seed: int = 3) -> None:
        rng = np.random.default_rng(seed)
        self._textures = [self._texture(rng) for _ in range(2)]

    @staticmethod
    def _texture(rng: np.random.Generator) -> NDArray[np.float32]:
        noise = gaussian_filter(rng.standard_normal((1024, 1024)), 1.6, mode="wrap")
        return (128.0 + 45.0 * noise / noise.std()).astype(np.float32)

    def pair(self, rig: Rig, T_world_left: Array) -> tuple[Image, Image]:
        """Left and right image from a pose (4, 4) of the left camera."""
        return self.image(rig.left, T_world_left), self.image(rig.right, T_world_left @ rig.T_left_right)

    def image(self, lens: CameraModel, T: Array) -> Image:
        """Image (H, W) uint8 of a camera with a lens from a pose (4, 4)."""
        rays = all_rays(lens) @ T[:3, :3].T
        image = np.zeros(SIZE[::-1], np.float32)
        for z, right_of, texture in ((12.0, -1e9, self._textures[0]), (6.0, 0.0, self._textures[1])):
            with np.errstate(divide="ignore"):
                distance = (z - T[2, 3]) / rays[..., 2]
            x, y = T[0, 3] + distance * rays[..., 0], T[1, 3] + distance * rays[..., 1]
            seen = (x > right_of) & (distance > 0)
            where = [(a / TEXEL % 1024).astype(np.float32) for a in (x, y)]
            shown = cv2.remap(texture, *where, cv2.INTER_CUBIC, borderMode=cv2.BORDER_WRAP)
            image[seen] = shown[seen]
        return np.clip(np.rint(image), 0, 255).astype(np.uint8)


_RAYS: dict[CameraModel, Array] = {}


def all_rays(lens: CameraModel) -> Array:
    """Direction (H, W, 3) of each pixel by OpenCV's own inverse of the distortion."""
    if lens not in _RAYS:
        pixels = np.stack(np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1])), axis=-1).reshape(-1, 1, 2) * 1.0
        stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-10)
        D = np.array(lens.coefficients or (0.0,) * 4)
        if lens.distortion_model in FISHEYE_MODELS:
            flat = cv2.fisheye.undistortPoints(pixels, lens.K, D)
        else:
            flat = cv2.undistortPoints(pixels, lens.K, D, criteria=stop)
        _RAYS[lens] = np.dstack([flat.reshape(SIZE[1], SIZE[0], 2), np.ones(SIZE[::-1])])
    return _RAYS[lens]


def seen_at(lens: CameraModel, points_camera: Array) -> Array:
    """Pixels (N, 2) of points (N, 3) by OpenCV's own projection."""
    D, zero = np.array(lens.coefficients or (0.0,) * 4), np.zeros(3)
    if lens.distortion_model in FISHEYE_MODELS:
        return cv2.fisheye.projectPoints(points_camera[:, None], zero, zero, lens.K, D)[0].reshape(-1, 2)
    return cv2.projectPoints(points_camera, zero, zero, lens.K, D)[0].reshape(-1, 2)


def rig_poses(count: int = 6) -> Array:
    """Poses T_world_left (N, 4, 4) of a drive ahead that turns a little."""
    step, poses = turned((0.1, 0.6, 0.0), (0.02, 0.0, 0.15)), [turned((3.0, -4.0, 2.0), (1.0, 2.0, -0.5))]
    for _ in range(count - 1):
        poses.append(poses[-1] @ step)
    return np.array(poses)


def wall_depth(rays: Array, T_world_camera: Array) -> Array:
    """Depth (H, W) of the walls along the optical axis of a camera, in directions (H, W, 3) with z = 1, metres."""
    world = rays @ T_world_camera[:3, :3].T
    depth = np.full(rays.shape[:2], np.nan)
    for z, right_of in ((12.0, -1e9), (6.0, 0.0)):
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = (z - T_world_camera[2, 3]) / world[..., 2]
        x = T_world_camera[0, 3] + distance * world[..., 0]
        seen = (x > right_of) & (distance > 0)
        depth[seen] = distance[seen]
    return depth
