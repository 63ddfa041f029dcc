import cv2
import numpy as np
import pytest

from odometry import se3
from slam.simulation.rendering.renderer import RenderFrame, build_scene, cull_scene, render_view
from slam.simulation.rendering.shading import LEAF
from slam.simulation.scenario.config import SimulationConfig
from slam.simulation.scenario.vehicle_path import plan_trajectory
from slam.simulation.simulator import SceneStream

CONFIG = SimulationConfig(width=640, height=192, difficulty="clean", cars_per_360m=0, max_frames=40)


@pytest.fixture(scope="module")
def street():
    """LitScene of a small drive, its poses, and a function that renders at a pose."""
    trajectory = plan_trajectory(CONFIG)
    stage, _ = next(iter(SceneStream(CONFIG, trajectory)))

    def see(T):
        return render_view(stage, cull_scene(stage, RenderFrame([]), CONFIG.camera, T), CONFIG.camera, T)

    return stage, trajectory.T_town_camera, see


def shifted(T, x):
    return T @ se3.pose(np.eye(3), np.array([x, 0.0, 0.0]))


def rays(camera):
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    return np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)


def test_the_same_pose_gives_the_same_image(street):
    _, poses, see = street
    np.testing.assert_array_equal(see(poses[7])[0], see(poses[7])[0])


def test_an_independent_ray_caster_sees_the_same_depth(street):
    o3d = pytest.importorskip("open3d", exc_type=ImportError)
    stage, poses, see = street
    camera, T = CONFIG.camera, poses[12]
    scene = cull_scene(stage, RenderFrame([]), camera, T)
    caster = o3d.t.geometry.RaycastingScene()
    corners = scene.corners.reshape(-1, 3)
    caster.add_triangles(
        o3d.core.Tensor(corners), o3d.core.Tensor(np.arange(len(corners), dtype=np.uint32).reshape(-1, 3))
    )
    directions = rays(camera) @ T[:3, :3].T
    origin = np.broadcast_to(T[:3, 3], directions.shape)
    cast = caster.cast_rays(o3d.core.Tensor(np.concatenate([origin, directions], -1).astype(np.float32)))
    truth = cast["t_hit"].numpy()  # rays have unit depth, so this is depth
    depth = see(T)[1]
    agree = np.isclose(depth, truth, rtol=0.02, atol=0.02) | (np.isinf(depth) & np.isinf(truth))
    # At edges ours is the nearest of four samples of the pixel.
    assert agree.mean() > 0.85
    inner = cv2.erode((np.abs(cv2.Laplacian(truth, cv2.CV_32F)) < 0.02).astype(np.uint8), np.ones((3, 3))) > 0
    assert agree[inner].mean() > 0.999


def test_a_static_point_keeps_its_place_in_the_next_frames(street):
    _, poses, see = street
    camera = CONFIG.camera
    depth_i, depth_j = see(poses[5])[1], see(poses[7])[1]
    points = (rays(camera) * np.minimum(depth_i, 1e3)[..., None]).reshape(-1, 3)
    seen = se3.transform(se3.inverse(poses[7]) @ poses[5], points)
    u, _, v = np.nan_to_num(camera.project(seen), nan=-1.0).T
    inside = (u > 1) & (u < camera.width - 2) & (v > 1) & (v < camera.height - 2) & (seen[:, 2] < 60)
    found = depth_j[np.rint(v[inside]).astype(int), np.rint(u[inside]).astype(int)]
    assert np.median(np.abs(found / seen[inside, 2] - 1)) < 0.01


def test_disparity_agrees_with_what_the_right_camera_sees(street):
    _, poses, see = street
    camera = CONFIG.camera
    left, depth = see(poses[20])
    right, _ = see(shifted(poses[20], camera.baseline))
    u, v = np.meshgrid(np.arange(camera.width, dtype=np.float32), np.arange(camera.height, dtype=np.float32))
    warped = cv2.remap(
        right, u - np.float32(camera.fx * camera.baseline) / depth.astype(np.float32), v, cv2.INTER_LINEAR
    )
    error = np.abs(warped - left)[:, 60:]
    unmoved = np.abs(right - left)[:, 60:]
    assert np.median(error) < 0.006
    assert error.mean() < 0.35 * unmoved.mean()


def test_moving_objects_hide_static_ones(street):
    stage, poses, see = street
    camera, T = CONFIG.camera, poses[5]
    board = build_board(T, 4.0)
    _, depth = render_view(stage, cull_scene(stage, RenderFrame([board]), camera, T), camera, T)
    at = int(camera.cy), int(camera.cx)
    assert depth[at] == pytest.approx(4.0, abs=1e-3)
    assert see(T)[1][at] > 4.5


def build_board(T, distance):
    from slam.simulation.world.materials import PLASTER
    from slam.simulation.world.mesh import quads

    corners = np.array([[-1.0, -1, distance], [1, -1, distance], [1, 1, distance], [-1, 1, distance]])
    return quads(se3.transform(T, corners)[None], np.zeros((1, 4, 2)), PLASTER)


def test_wind_moves_leaves_and_nothing_else(street):
    stage, poses, _ = street
    calm, blown = (cull_scene(stage, RenderFrame([], wind), CONFIG.camera, poses[5]) for wind in (None, 3.0))
    moved = np.abs(blown.corners - calm.corners).max(axis=(1, 2))
    leaf = stage.materials.table[calm.material, LEAF] > 0
    assert (moved[~leaf] == 0).all()
    assert 0 < np.median(moved[leaf]) <= moved.max() < 0.03


def test_texture_coordinates_are_planar_over_each_triangle(street):
    _stage, _, _ = street
    rng = np.random.default_rng(0)
    from slam.simulation.world.mesh import triangles

    corners, uv = rng.normal(size=(20, 3, 3)), rng.normal(size=(20, 3, 2))
    a = build_scene([triangles(corners, uv, 0)]).attributes
    u = np.einsum("tk,tik->ti", a[:, 0:3], corners) + a[:, 3:4]
    v = np.einsum("tk,tik->ti", a[:, 4:7], corners) + a[:, 7:8]
    np.testing.assert_allclose(np.stack([u, v], -1), uv, atol=1e-3)
