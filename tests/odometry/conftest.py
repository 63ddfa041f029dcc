"""A small world with exact truth, and the real drives."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

from odometry import se3
from odometry.camera import StereoCamera
from odometry.stereo.two_view_adjustment import StereoTracks

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Pair = tuple[Image, Image]


class World:
    """Textured panels that face the camera at several depths, before a far backdrop."""

    def __init__(self, camera: StereoCamera, seed: int = 7) -> None:
        self.camera = camera
        rng = np.random.default_rng(seed)
        self._panels = [(0.0, 0.0, 60.0, 200.0, self._texture(rng))]  # x, y, z, half width, texture
        for x, y, z in [(-9, 0, 26), (8, -2, 20), (-4.5, 2.5, 14), (4.5, 2, 11), (0, -3.5, 16), (-7, -3, 17)]:
            self._panels.append((float(x), float(y), float(z), 2.2, self._texture(rng)))

    @staticmethod
    def _texture(rng: np.random.Generator) -> Array:
        noise = gaussian_filter(rng.standard_normal((512, 512)), 0.8, mode="wrap")
        return 128.0 + 45.0 * noise / noise.std()

    def pair(self, T_world_camera: Array) -> Pair:
        """Left and right image (H, W) uint8 from a pose (4, 4)."""
        shift = se3.pose(np.eye(3), np.array([self.camera.baseline, 0.0, 0.0]))
        return self._image(T_world_camera)[0], self._image(T_world_camera @ shift)[0]

    def frame(self, T_world_camera: Array, noise_px: float = 0.1, seed: int = 0) -> tuple[Image, NDArray[np.float32]]:
        """Image (H, W) uint8 and depth (H, W) float32 from a pose (4, 4), with noise in the disparity."""
        image, depth = self._image(T_world_camera)
        scale, rng = self.camera.fx * self.camera.baseline, np.random.default_rng(seed)
        disparity = scale / depth + rng.normal(0, noise_px, depth.shape)
        return image, (scale / np.maximum(disparity, 0.5)).astype(np.float32)

    def _image(self, T: Array) -> tuple[Image, Array]:
        c = self.camera
        u, v = np.meshgrid(np.arange(c.width), np.arange(c.height))
        rays = np.stack([(u - c.cx) / c.fx, (v - c.cy) / c.fy, np.ones(u.shape)], axis=-1) @ T[:3, :3].T
        image, nearest = np.zeros(u.shape), np.full(u.shape, np.inf)
        for x, y, z, half, texture in self._panels:
            distance = (z - T[2, 3]) / rays[..., 2]
            X, Y = T[0, 3] + distance * rays[..., 0] - x, T[1, 3] + distance * rays[..., 1] - y
            hit = (np.abs(X) < half) & (np.abs(Y) < half) & (distance > 0.5) & (distance < nearest)
            texel = 4.0 * z / c.fx  # metres: four pixels when seen from the origin
            where = np.stack([Y[hit], X[hit]]) / texel
            image[hit] = map_coordinates(texture, where, order=3, mode="grid-wrap")
            nearest[hit] = distance[hit]
        return np.clip(np.rint(image), 0, 255).astype(np.uint8), nearest


@pytest.fixture(scope="session")
def camera() -> StereoCamera:
    return StereoCamera(fx=350.0, fy=350.0, cx=255.5, cy=111.5, baseline=0.5, width=512, height=224)


@pytest.fixture(scope="session")
def world(camera: StereoCamera) -> World:
    return World(camera)


@pytest.fixture(scope="session")
def motion_true() -> Array:
    """T_previous_current of the simulated drive: ahead, a little to the side, turning."""
    return se3.exp(np.array([0.002, 0.01, -0.001, 0.03, -0.01, 0.4]))


@pytest.fixture(scope="session")
def drive(world: World, motion_true: Array) -> list[Pair]:
    """Ten pairs with the same motion between any two."""
    T, pairs = np.eye(4), []
    for _ in range(10):
        pairs.append(world.pair(T))
        T = T @ motion_true
    return pairs


@pytest.fixture(scope="session")
def depth_drive(world: World, motion_true: Array) -> list[tuple[Image, NDArray[np.float32]]]:
    """The same ten images with their depth."""
    return [world.frame(np.linalg.matrix_power(motion_true, k), seed=k) for k in range(10)]


@pytest.fixture(scope="session")
def simulate() -> Callable[..., StereoTracks]:
    """Measurements of random points with known motion, noise and rectification error."""
    return simulate_tracks


def simulate_tracks(
    camera: StereoCamera, T_first_second: Array, rng: np.random.Generator, noise_px: float = 0.2,
    depths: tuple[float, float] = (6.0, 120.0), offset_px: tuple[float, float] = (0.0, 0.0), count: int = 250,
) -> StereoTracks:  # fmt: skip
    """Tracks of random points between two depths, metres, the first left pixel exact, all others noisy."""
    pixels = rng.uniform([0, 0], [camera.width, camera.height], (count, 2))
    disparity = camera.fx * camera.baseline * rng.uniform(1 / depths[1], 1 / depths[0], count)
    points = camera.triangulate(pixels, disparity)
    first = camera.project(points)
    second = camera.project(se3.transform(se3.inverse(T_first_second), points))
    seen = (second[:, 0] > 0) & (second[:, 0] < camera.width)
    noise = rng.normal(0, noise_px, (3, count, 2))
    first_right, second_left = first[:, 1:] + offset_px + noise[0], second[:, [0, 2]] + noise[1]
    # As in the odometry, the second right place is where the second left one, noise and all, is found again.
    second_right = second[:, 1:] + offset_px + noise[1] + noise[2]
    places = [p[seen] for p in (pixels, first_right, second_left, second_right)]
    return StereoTracks(*places, np.flatnonzero(seen))


Clip = tuple[StereoCamera, list[Pair], Array]


@pytest.fixture(scope="session")
def clip(test_data: Path) -> Callable[..., Clip]:
    """Reader of a real drive: camera, pairs, true poses (N, 4, 4)."""
    return lambda name, count=1000: _read_clip(test_data / "kitti_clips", name, count)


def _read_clip(root: Path, name: str, count: int) -> Clip:
    folder = root / "sequences" / name
    rows = dict(line.split(":") for line in (folder / "calib.txt").read_text().splitlines() if line.strip())
    left, right = (np.array(rows[key].split(), dtype=np.float64).reshape(3, 4) for key in ("P0", "P1"))
    files = sorted((folder / "image_0").glob("*.png"))[:count]
    pairs = [(cv2.imread(str(f), 0), cv2.imread(str(folder / "image_1" / f.name), 0)) for f in files]
    height, width = pairs[0][0].shape
    camera = StereoCamera(left[0, 0], left[1, 1], left[0, 2], left[1, 2], -right[0, 3] / right[0, 0], width, height)
    poses = np.tile(np.eye(4), (len(files), 1, 1))
    poses[:, :3] = np.loadtxt(root / "poses" / f"{name}.txt").reshape(-1, 3, 4)[: len(files)]
    return camera, pairs, poses
