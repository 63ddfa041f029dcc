"""Meshes keep their shape when they are moved, and cars drive where and when they should."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slam.simulation.scenario.config import SimulationConfig
from slam.simulation.scenario.vehicle_path import LANE, plan_trajectory
from slam.simulation.world import materials as m
from slam.simulation.world.mesh import boxes, merge_meshes, panel, prism, quads
from slam.simulation.world.town import PlacedMesh
from slam.simulation.world.vehicles import CAR_TYPES, Traffic, car, fleet


def areas(corners: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2


@settings(max_examples=40, deadline=None)
@given(yaw=st.floats(-7, 7), scale=st.floats(0.2, 5.0), x=st.floats(-100, 100))
def test_a_moved_mesh_is_similar_to_itself(yaw: float, scale: float, x: float) -> None:
    mesh = car("saloon", 1.0)
    moved = PlacedMesh(mesh, yaw, (x, 2.0, 0.5), scale, 0.7).to_town_frame()
    np.testing.assert_allclose(areas(moved.corners), scale**2 * areas(mesh.corners), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(moved.corners[..., 2], scale * mesh.corners[..., 2] + 0.5, atol=1e-9)
    np.testing.assert_allclose(moved.tint, 0.7 * mesh.tint)
    np.testing.assert_array_equal(moved.uv, mesh.uv)


def test_yaw_turns_counter_clockwise_from_above() -> None:
    point = quads(np.tile([[1.0, 0.0, 0.0]], (1, 4, 1)), np.zeros((1, 4, 2)), 0)
    np.testing.assert_allclose(point.transform(np.pi / 2, np.zeros(3)).corners[0, 0], [0.0, 1.0, 0.0], atol=1e-12)


def test_merging_keeps_every_triangle_also_of_no_mesh() -> None:
    parts = [
        boxes([0, 0, 0], [1, 1, 1], 3),
        prism(0.1, 0.1, 2.0, 4),
        panel([0, 0, 0], [1, 0, 0], [0, 0, 1], 5, [0, 0, 1, 1]),
    ]
    merged = merge_meshes(parts)
    assert len(merged) == sum(map(len, parts))
    np.testing.assert_array_equal(np.unique(merged.material), [3, 4, 5])
    assert len(merge_meshes([])) == 0


@settings(max_examples=30, deadline=None)
@given(size=st.tuples(*[st.floats(0.1, 9.0)] * 3))
def test_a_box_has_the_surface_of_a_box_without_its_floor(size: tuple[float, float, float]) -> None:
    x, y, z = size
    box = boxes([0, 0, 0], list(size), m.PLASTER)
    assert areas(box.corners).sum() == pytest.approx(2 * (x + y) * z + x * y)
    assert (box.corners >= 0).all()
    np.testing.assert_allclose(box.corners.max(axis=(0, 1)), size)


@pytest.mark.parametrize("car_type", CAR_TYPES)
def test_cars_have_the_size_of_cars_and_stand_on_the_road(car_type: str) -> None:
    corners = car(car_type, 1.0).corners.reshape(-1, 3)
    length, width, height = np.ptp(corners, axis=0)
    assert 3.5 < length < 5.0
    assert 1.6 < width < 2.0
    assert 1.3 < height < 2.2
    assert 0.0 <= corners[:, 2].min() < 0.1


CONFIG = SimulationConfig(shape="blocks", length_m=720, laps=1, cars_per_360m=6)


@pytest.fixture(scope="module")
def traffic() -> Traffic:
    return Traffic(CONFIG, plan_trajectory(CONFIG), fleet(CONFIG.rng(3)))


def centres(traffic: Traffic, frame: int) -> np.ndarray:
    found = [mesh.corners.reshape(-1, 3)[:, :2].mean(axis=0) for mesh in traffic.meshes_at(frame)]
    return np.array(found).reshape(-1, 2)


def test_the_number_of_cars_is_per_360_m(traffic: Traffic) -> None:
    assert len(traffic.meeting_m) == 12
    none = SimulationConfig(length_m=720, cars_per_360m=0)
    trajectory = plan_trajectory(none)
    assert all(Traffic(none, trajectory, fleet(none.rng(3))).meshes_at(frame) == [] for frame in (0, 100, 400))


def test_each_car_is_met_at_its_meeting_point(traffic: Traffic) -> None:
    trajectory = traffic.trajectory
    for meeting_m in traffic.meeting_m:
        if not 5.0 < meeting_m < trajectory.distance_m[-1] - 5.0:
            continue
        frame = int(np.searchsorted(trajectory.distance_m, meeting_m))
        camera = trajectory.T_town_camera[frame, :2, 3]
        assert np.linalg.norm(centres(traffic, frame) - camera, axis=1).min() < 2 * LANE + 2.5


def test_no_car_is_ever_where_the_camera_is(traffic: Traffic) -> None:
    for frame in range(0, 700, 7):
        apart = np.linalg.norm(centres(traffic, frame) - traffic.trajectory.T_town_camera[frame, :2, 3], axis=1)
        assert len(apart) == 0 or apart.min() > 2.0


def test_no_car_waits_for_the_camera_at_the_end_of_the_path() -> None:
    config = SimulationConfig(length_m=310, laps=1, cars_per_360m=12)  # a car drives ahead until the end
    trajectory = plan_trajectory(config)
    traffic = Traffic(config, trajectory, fleet(config.rng(3)))
    met = 0
    for frame in range(240, len(trajectory.distance_m)):
        apart = np.linalg.norm(centres(traffic, frame) - trajectory.T_town_camera[frame, :2, 3], axis=1)
        met += len(apart)
        assert len(apart) == 0 or apart.min() > 2.0
    assert met > 0


def test_oncoming_cars_approach_and_the_car_ahead_keeps_its_distance(traffic: Traffic) -> None:
    before, after = (centres(traffic, frame) for frame in (40, 43))
    ahead = [np.linalg.norm(c[-1] - traffic.trajectory.T_town_camera[f, :2, 3]) for c, f in ((before, 40), (after, 43))]
    assert all(5.0 < distance < 60.0 for distance in ahead)
    assert abs(ahead[1] - ahead[0]) < 3.0
