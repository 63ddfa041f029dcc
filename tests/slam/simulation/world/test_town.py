import numpy as np
import pytest
from scipy.spatial import cKDTree

from slam.simulation.scenario.config import SimulationConfig
from slam.simulation.scenario.vehicle_path import plan_trajectory
from slam.simulation.world import materials as m
from slam.simulation.world import town
from slam.simulation.world.buildings import build_house
from slam.simulation.world.town import TownBuilder

GROUND = (m.ASPHALT, m.PAVEMENT, m.KERB, m.GRASS, *range(m.ROAD, m.ROAD + m.ROADS))


def solid_below(parts, height):
    """Corners (N, 3) of everything but ground that hangs lower than `height`."""
    meshes = [part.to_town_frame() for part in parts]
    corners = np.concatenate([mesh.corners[~np.isin(mesh.material, GROUND)] for mesh in meshes])
    return corners[corners[:, :, 2].min(axis=1) < height]


@pytest.mark.parametrize(("shape", "reverse"), [("circle", True), ("figure-eight", False), ("blocks", False)])
def test_nothing_stands_on_the_route(shape, reverse):
    config = SimulationConfig(shape=shape, length_m=400, reverse=reverse, lateral_offset_m=1.0)
    trajectory = plan_trajectory(config)
    corners = solid_below(TownBuilder(config, trajectory).build(), 2.0)
    # Points all over each triangle, so that no long wall slips through between its corners.
    corners = corners[:, :, :2]
    tree = cKDTree(trajectory.path.points)
    corners = corners[tree.query(corners[:, 0], distance_upper_bound=20)[0] < 20]
    weights = np.array([[a, b, 4 - a - b] for a in range(5) for b in range(5 - a)]) / 4
    points = np.unique((weights @ corners).reshape(-1, 2).round(1), axis=0)
    assert tree.query(points, distance_upper_bound=2)[0].min() > 0.9


def test_streets_are_lined_on_both_sides():
    config = SimulationConfig()
    trajectory = plan_trajectory(config)
    corners = solid_below(TownBuilder(config, trajectory).build(), 1.0)[:, 0]
    for frame in range(0, 360, 40):
        T = np.linalg.inv(trajectory.T_town_camera[frame])
        x = (corners @ T[:3, :3].T + T[:3, 3])[:, [0, 2]]
        beside = x[(np.abs(x[:, 1]) < 15) & (np.abs(x[:, 0]) < 20), 0]
        assert (beside > 0).any()
        assert (beside < 0).any()


def test_the_town_of_a_seed_is_always_the_same_and_another_seed_has_another():
    def corners(seed):
        config = SimulationConfig(length_m=200, seed=seed)
        return [mesh.position for mesh in TownBuilder(config, plan_trajectory(config)).build()]

    assert corners(1) == corners(1)
    assert corners(1) != corners(2)


def test_similar_streets_have_houses_of_the_same_design(monkeypatch):
    def designs(alike):
        drawn = []
        monkeypatch.setattr(town, "build_house", lambda house, *rest: drawn.append(house) or build_house(house, *rest))
        config = SimulationConfig(shape="blocks", length_m=1000, perceptual_aliasing=alike)
        TownBuilder(config, plan_trajectory(config)).build()
        return drawn

    twins, others = designs(alike=True), designs(alike=False)
    assert len(twins) - len(set(twins)) >= 4
    assert len(others) == len(set(others))


def test_a_street_driven_twice_is_built_once():
    config = SimulationConfig(shape="blocks", length_m=800)
    streets = TownBuilder(config, plan_trajectory(config)).streets
    assert streets.joined.sum() < 0.8 * len(streets.points)
