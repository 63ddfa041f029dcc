"""Streets follow the path and the scenes of a dataset cover all its frames."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from slam.simulation.rendering.renderer import RenderFrame, build_scene, build_shadow_map, cull_scene
from slam.simulation.scenario.config import SimulationConfig
from slam.simulation.scenario.vehicle_path import LANE, plan_base_path, plan_trajectory
from slam.simulation.simulator import SceneStream, choose_daylight
from slam.simulation.world import street_objects
from slam.simulation.world.buildings import build_house, draw_house
from slam.simulation.world.materials import FRONTS
from slam.simulation.world.streets import ROAD_HALF, ground, lay_streets

CONFIG = SimulationConfig(shape="blocks", length_m=800, width=160, height=64)


@pytest.fixture(scope="module")
def stream() -> SceneStream:
    return SceneStream(CONFIG, plan_trajectory(CONFIG))


def test_the_path_runs_in_the_right_lane_of_its_street() -> None:
    base, trajectory = plan_base_path(CONFIG), plan_trajectory(CONFIG)
    streets = lay_streets(base, trajectory)
    distance = cKDTree(streets.points[streets.joined]).query(base.points)[0]
    assert np.median(distance) == pytest.approx(LANE, abs=0.3)
    assert np.percentile(distance, 95) < ROAD_HALF


def test_points_on_the_path_are_not_clear_and_points_far_away_are() -> None:
    trajectory = plan_trajectory(CONFIG)
    streets = lay_streets(plan_base_path(CONFIG), trajectory)
    assert not streets.is_clear(trajectory.path.points[100:101] + 0.5, 1.0)
    assert streets.is_clear(trajectory.path.points.max(axis=0, keepdims=True) + 50.0, 1.0)


def test_there_is_ground_below_every_frame() -> None:
    trajectory = plan_trajectory(CONFIG)
    streets = lay_streets(plan_base_path(CONFIG), trajectory)
    corners = np.concatenate([mesh.corners for mesh in ground(streets, CONFIG.rng(4))])
    shadow = build_shadow_map(_scene(corners), np.array([1e-6, 0.0, 1.0]), trajectory.T_town_camera[:, :2, 3], 5.0)
    place = trajectory.T_town_camera[:, :3, 3] @ shadow.axes.T
    cells = np.rint((place[:, :2] - shadow.origin) / shadow.cell_m).astype(int)
    heights = shadow.heights[cells[:, 1], cells[:, 0]]
    assert np.abs(heights).max() < 0.15  # road or kerb, nowhere a hole and nowhere a wall


def _scene(corners: np.ndarray):
    from slam.simulation.world.mesh import triangles

    return build_scene([triangles(corners, np.zeros((len(corners), 3, 2)), 0)])


def test_every_frame_has_one_scene_in_order(stream: SceneStream) -> None:
    runs = list(stream._stretches())
    assert [frame for run in runs for frame in run] == list(range(len(stream.trajectory.distance_m)))
    positions = stream.trajectory.T_town_camera[:, :2, 3]
    assert max(np.ptp(positions[run.start : run.stop], axis=0).max() for run in runs) <= 220.0


def test_scenes_end_with_the_lap_where_the_light_changes() -> None:
    config = SimulationConfig(length_m=200, laps=3, change_illumination=True, width=160, height=64)
    stream = SceneStream.__new__(SceneStream)  # without its town, which takes seconds to build
    stream.config, stream.trajectory = config, plan_trajectory(config)
    for run in stream._stretches():
        assert len(set(stream.trajectory.lap[run.start : run.stop].tolist())) == 1


def test_later_laps_have_another_sun_if_asked_for() -> None:
    config = SimulationConfig(change_illumination=True)
    suns = [choose_daylight(config, lap) for lap in range(4)]
    assert all(np.linalg.norm(light.to_sun) == pytest.approx(1.0) for light in suns)
    assert suns[0].to_sun @ suns[1].to_sun < 0.9
    np.testing.assert_array_equal(suns[0].to_sun, suns[3].to_sun)
    same = [choose_daylight(SimulationConfig(), lap) for lap in (0, 1)]
    np.testing.assert_array_equal(same[0].to_sun, same[1].to_sun)
    np.testing.assert_array_equal(same[0].panorama, same[1].panorama)


def test_culling_keeps_every_triangle_that_projects_into_the_image(stream: SceneStream) -> None:
    lit, frames = next(iter(stream))
    camera, T = CONFIG.camera, stream.trajectory.T_town_camera[frames.start + 30]
    kept = cull_scene(lit, RenderFrame([]), camera, T)
    R, centre = T[:3, :3], T[:3, 3]
    points = (lit.scene.corners.astype(float).reshape(-1, 3) - centre) @ R
    with np.errstate(all="ignore"):
        u = camera.fx * points[:, 0] / points[:, 2] + camera.cx
        v = camera.fy * points[:, 1] / points[:, 2] + camera.cy
    inside = (points[:, 2] > 0.2) & (u > 0) & (u < camera.width) & (v > 0) & (v < camera.height)
    visible = inside.reshape(-1, 3).all(axis=1).sum()
    again = (kept.corners.astype(float).reshape(-1, 3) - centre) @ R
    with np.errstate(all="ignore"):
        u = camera.fx * again[:, 0] / again[:, 2] + camera.cx
        v = camera.fy * again[:, 1] / again[:, 2] + camera.cy
    inside = (again[:, 2] > 0.2) & (u > 0) & (u < camera.width) & (v > 0) & (v < camera.height)
    assert inside.reshape(-1, 3).all(axis=1).sum() == visible > 1000
    assert len(kept.corners) < 0.7 * len(lit.scene.corners)


def test_bounding_spheres_contain_their_clusters(stream: SceneStream) -> None:
    lit, _ = next(iter(stream))
    scene = lit.scene
    for k in range(0, len(scene.ranges), 50):
        first, last = scene.ranges[k]
        away = np.linalg.norm(scene.corners[first:last].reshape(-1, 3) - scene.centres[k], axis=1)
        assert away.max() <= scene.radii[k] + 1e-3


@pytest.mark.parametrize("urban", [True, False])
def test_houses_have_their_size_and_stand_on_the_ground(urban: bool) -> None:
    for seed in range(6):
        rng = np.random.default_rng(seed)
        house = draw_house(rng, 12.0, urban)
        mesh = build_house(house, rng, urban)
        low, high = mesh.corners.min(axis=(0, 1)), mesh.corners.max(axis=(0, 1))
        assert 0 <= house.front < FRONTS
        assert (3 if urban else 1) <= house.storeys <= (5 if urban else 3)
        assert abs(low[2]) < 0.1
        assert high[2] > house.eaves
        assert -3.0 < low[0] < 0.1
        assert 11.9 < high[0] < 15.0
        assert house.depth <= high[1] < house.depth + 1.0


def test_plants_have_their_height_and_stand_upright() -> None:
    rng = np.random.default_rng(0)
    for mesh, height in ((street_objects.broadleaf(rng, 9.0), 9.0), (street_objects.conifer(rng, 11.0), 11.0)):
        corners = mesh.corners.reshape(-1, 3)
        assert 0.8 * height < corners[:, 2].max() < 1.25 * height
        assert np.abs(corners[:, :2].mean(axis=0)).max() < 0.15 * height
    assert street_objects.bush(rng).corners[..., 2].max() < 2.5


@pytest.mark.parametrize("kind", [1, 2, 3, 4])
def test_borders_are_as_long_as_asked_for(kind: int) -> None:
    mesh = street_objects.border(kind, 12.0, np.random.default_rng(1))
    low, high = mesh.corners.min(axis=(0, 1)), mesh.corners.max(axis=(0, 1))
    assert -0.1 < low[0] < 0.1
    assert 11.5 < high[0] < 12.6
    assert 0.8 < high[2] < 2.0
    assert max(abs(low[1]), abs(high[1])) < 0.5
