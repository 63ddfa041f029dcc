"""The dense map of a depth camera: its depth images without edges, fused to the surfaces of a box-shaped room."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from odometry import se3
from odometry.camera import StereoCamera
from odometry.stereo.stereo_self_calibration import ExactCalibration
from slam.datasets.dataset import Frame
from slam.mapping.dense_mapper import DenseMapConfig, DenseMapper, OdometryTrajectory
from slam.mapping.measured_depth import MeasuredDepth
from slam.mapping.occupancy_grid import FREE, OCCUPIED, UNKNOWN, build_floor_grid, find_floor
from slam.mapping.submaps import SubmapStore
from slam.mapping.tsdf import DEPTH_CAMERA_FUSION

CAMERA = StereoCamera(262.5, 262.5, 159.5, 119.5, 0.075, 320, 240)
WALLS = np.array([2.0, 1.3, 2.5])  # distances from the middle of the room, metres
NOISE_PX = 0.1
ROOMY = replace(DEPTH_CAMERA_FUSION, voxel_m=0.04)


def rays(camera: StereoCamera) -> NDArray[np.float64]:
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    return np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)


def see(T_world_camera: NDArray[np.float64], noise_px: float = 0.0, seed: int = 0) -> NDArray[np.float32]:
    """Depth image (H, W) of the room from a pose (4, 4)."""
    direction = rays(CAMERA) @ T_world_camera[:3, :3].T
    with np.errstate(divide="ignore"):
        depth = np.min((np.sign(direction) * WALLS - T_world_camera[:3, 3]) / direction, axis=2)
    scale = CAMERA.fx * CAMERA.baseline
    disparity = scale / depth + np.random.default_rng(seed).normal(0, noise_px, depth.shape)
    return (scale / np.maximum(disparity, 0.1)).astype(np.float32)


def frame(depth: NDArray[np.float32] | None, index: int = 0) -> Frame:
    return Frame(index, 0.1 * index, np.full((CAMERA.height, CAMERA.width), 90, np.uint8), None, depth=depth)


def test_a_wall_is_kept_as_it_is():
    depth = see(np.eye(4))
    image = MeasuredDepth(CAMERA, 4.0).depth_of(frame(depth))
    assert image.camera == CAMERA
    np.testing.assert_array_equal(image.depth, depth)
    assert (image.color == 90).all()


def test_holes_and_far_pixels_are_unknown():
    depth = see(np.eye(4))
    depth[:50], depth[50:60], depth[60:70] = np.nan, 0.0, np.inf
    image = MeasuredDepth(CAMERA, 2.2).depth_of(frame(depth))
    assert not image.depth[:70].any()
    np.testing.assert_array_equal(image.depth[70:] > 0, depth[70:] <= 2.2)
    assert not MeasuredDepth(CAMERA, 4.0).depth_of(frame(None)).depth.any()


def test_the_pixels_at_an_edge_are_left_out_and_no_others():
    depth = np.full((CAMERA.height, CAMERA.width), 2.0, np.float32)
    depth[:, :100] = 1.0
    kept = MeasuredDepth(CAMERA, 4.0).depth_of(frame(depth)).depth > 0
    assert not kept[:, 99:101].any()
    assert kept[:, :99].all()
    assert kept[:, 101:].all()


def test_a_large_image_is_read_at_every_second_pixel_where_its_camera_says():
    large = StereoCamera(1050.0, 1050.0, 639.5, 479.5, 0.075, 1280, 960)
    normal = np.array([0.3, -0.2, 0.9])
    depth = (2.0 / (rays(large) @ normal)).astype(np.float32)
    left = np.zeros((960, 1280), np.uint8)
    image = MeasuredDepth(large, 4.0).depth_of(Frame(0, 0.0, left, None, depth=depth))
    assert image.depth.shape == image.color.shape[:2] == (480, 640)
    assert (image.camera.width, image.camera.height) == (640, 480)
    points = rays(image.camera) * image.depth[:, :, None]
    np.testing.assert_allclose(points @ normal, 2.0, atol=1e-5)


@dataclass(frozen=True)
class Room:
    """A recording of the room, as far as the mapper needs it."""

    depths: list[NDArray[np.float32]]
    color: tuple[int, int, int] | None = None

    def __len__(self) -> int:
        return len(self.depths)

    def __getitem__(self, index: int) -> Frame:
        return frame(self.depths[index], index)

    def __iter__(self) -> Iterator[Frame]:
        return (self[index] for index in range(len(self)))

    def read_left(self, index: int) -> NDArray[np.uint8]:
        return self[index].left

    def read_color(self, index: int) -> NDArray[np.uint8] | None:
        return None if self.color is None else np.full((CAMERA.height, CAMERA.width, 3), self.color, np.uint8)


@pytest.mark.parametrize(("factor", "is_good"), [(1.0, True), (1.05, False)], ids=["measured", "control"])
def test_the_fused_surface_is_that_of_the_room(tmp_path, factor, is_good):
    poses = np.array([se3.exp(np.array([0.0, 0.1 * k, 0.0, 0.02 * k, 0.0, 0.0])) for k in range(12)])
    room = Room([see(T, NOISE_PX, k) * np.float32(factor) for k, T in enumerate(poses)])
    store, config = SubmapStore(tmp_path), DenseMapConfig(fusion=DEPTH_CAMERA_FUSION)
    mapper = DenseMapper(ExactCalibration.of(CAMERA), config, has_depth=True)
    trajectory = OdometryTrajectory(poses, np.zeros(len(poses), bool))
    assert list(mapper.fuse(room, trajectory, [list(range(12))], store)) == list(range(1, 13))
    [surface] = store.surfaces_in_world(poses)
    assert len(surface.points) > 5000
    error = np.abs(np.abs(surface.points) - WALLS).min(axis=1)
    assert (np.median(error) < 0.01) == is_good
    assert (np.percentile(error, 95) < 0.04) == is_good


@pytest.mark.parametrize(("color", "shown"), [((200, 10, 90), (200, 10, 90)), (None, (90, 90, 90))])
def test_the_surface_has_the_colors_of_the_recording(tmp_path, color, shown):
    poses = np.repeat(np.eye(4)[None], 5, axis=0)
    store = SubmapStore(tmp_path)
    mapper = DenseMapper(ExactCalibration.of(CAMERA), DenseMapConfig(fusion=DEPTH_CAMERA_FUSION), has_depth=True)
    room = Room([see(T) for T in poses], color)
    list(mapper.fuse(room, OdometryTrajectory(poses, np.zeros(5, bool)), [list(range(5))], store))
    [submap] = store
    assert len(submap.surface.points) > 1000
    assert (submap.surface.color == shown).all()


@pytest.fixture(scope="module")
def tilted(tmp_path_factory):
    """A box on the floor of the room, seen by a camera that looks down by 20 degrees; its store and its trajectory."""
    lean = se3.exp(np.array([-0.35, 0.0, 0.0, 0.0, 0.0, 0.0]))
    turned = [se3.exp(np.array([0.0, 0.3 * k, 0.0, 0.0, 0.0, 0.0])) @ lean for k in range(21)]
    poses = np.array([se3.inverse(turned[0]) @ T for T in turned])
    store = SubmapStore(tmp_path_factory.mktemp("submaps"))
    mapper = DenseMapper(ExactCalibration.of(CAMERA), DenseMapConfig(fusion=replace(ROOMY, min_views=1)), True)
    room = Room([see(T) for T in turned])
    list(mapper.fuse(room, OdometryTrajectory(poses, np.zeros(21, bool)), [list(range(21))], store))
    return store, poses, se3.inverse(turned[0])


def test_the_floor_of_a_room_is_found_however_the_camera_is_held(tilted):
    store, poses, T_world_room = tilted
    floor = find_floor(store, poses)
    assert floor.down_m == pytest.approx(WALLS[1], abs=0.01)
    down = floor.T_level_world[:3, :3] @ T_world_room[:3, 1]
    assert np.degrees(np.arccos(down[1])) < 0.3
    assert np.degrees(np.arccos(T_world_room[1, 1])) > 15  # control: the first camera is not level


def test_the_floor_of_a_room_is_free_and_its_walls_are_occupied(tilted):
    store, poses, _ = tilted
    floor = find_floor(store, poses)
    grid = build_floor_grid(store, floor.T_level_world @ poses, floor)
    assert np.mean(grid.cells == FREE) > 0.5
    rows, columns = np.nonzero(grid.cells[::-1] == OCCUPIED)
    forward, left = (np.stack([columns, rows]) + 0.5) * grid.resolution_m + grid.origin[:, None]
    off = np.minimum(np.abs(np.abs(forward) - WALLS[2]), np.abs(np.abs(left) - WALLS[0]))
    assert len(off) > 150
    assert np.percentile(off, 95) < 0.1


def test_where_no_floor_is_seen_nothing_is_known(tmp_path):
    floor = find_floor(SubmapStore(tmp_path), np.eye(4)[None])
    assert np.isnan(floor.down_m)
    grid = build_floor_grid(SubmapStore(tmp_path), np.eye(4)[None], floor)
    assert (grid.cells == UNKNOWN).all()
