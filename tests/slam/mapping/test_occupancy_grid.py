"""The grid of what can be driven on, read as map_server would read it."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from odometry import se3
from slam.mapping.occupancy_grid import (
    FREE,
    OCCUPIED,
    UNKNOWN,
    OccupancyGrid,
    build_occupancy_grid,
    write_occupancy_grid,
)
from slam.mapping.submaps import Submap, SubmapStore
from slam.mapping.tsdf import FusionConfig, TsdfVolume

from .scenes import ahead, seen


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> SubmapStore:
    """One submap of the street, anchored at its fourth camera, frame 7."""
    poses = ahead(*range(8))
    T_anchor_camera = se3.inverse(poses[3]) @ poses
    volume, store = TsdfVolume(FusionConfig()), SubmapStore(tmp_path_factory.mktemp("submaps"))
    for T_world_camera, T in zip(poses, T_anchor_camera, strict=True):
        volume.integrate(seen(T_world_camera), T)
    store.add(Submap(7, np.arange(4, 12), T_anchor_camera, volume.extract_surface()))
    return store


def trajectory(T_world_anchor: np.ndarray) -> np.ndarray:
    return np.repeat(T_world_anchor[None], 8, axis=0)


def read(path: Path) -> tuple[np.ndarray, dict]:
    """Read as the convention says: probabilities (H, W), rows from the bottom up, NaN where unknown."""
    said = yaml.safe_load(path.read_text())
    image = cv2.imread(str(path.parent / said["image"]), cv2.IMREAD_UNCHANGED)
    assert image.ndim == 2
    assert image.dtype == np.uint8
    chance = image / 255.0 if said["negate"] else (255 - image.astype(float)) / 255.0
    known = (chance > said["occupied_thresh"]) | (chance < said["free_thresh"])
    return np.where(known, chance > said["occupied_thresh"], np.nan)[::-1], said


def test_road_is_free_and_the_wall_is_not_where_the_map_says(store: SubmapStore, tmp_path: Path) -> None:
    write_occupancy_grid(tmp_path / "occupancy.yaml", build_occupancy_grid(store, trajectory(ahead(3.0)[0])))
    occupied, said = read(tmp_path / "occupancy.yaml")

    def at(forward: float, left: float) -> float:
        column, row = np.floor((np.array([forward, left]) - said["origin"][:2]) / said["resolution"]).astype(int)
        inside = 0 <= row < occupied.shape[0] and 0 <= column < occupied.shape[1]
        return float(occupied[row, column]) if inside else np.nan

    assert said["mode"] == "trinary"
    assert [at(z, left) for z in (12.0, 15.0, 20.0) for left in (-2.0, 0.0, 2.0)] == [0.0] * 9
    assert max(at(12.0, 3.9), at(12.0, 4.1)) == 1.0
    assert np.isnan(at(12.0, 4.7))  # behind the wall


def test_the_grid_follows_the_corrected_trajectory(store: SubmapStore) -> None:
    """A quarter turn to the left, and 10 m ahead: what was ahead is to the left."""
    turned = se3.pose(np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]), np.array([0.0, 0.0, 10.0]))
    here, there = build_occupancy_grid(store, trajectory(np.eye(4))), build_occupancy_grid(store, trajectory(turned))
    counts = [[int((grid.cells == value).sum()) for value in (FREE, OCCUPIED)] for grid in (here, there)]
    assert here.cells.shape == pytest.approx(there.cells.shape[::-1], abs=1)
    assert counts[0] == pytest.approx(counts[1], rel=0.1)
    x, y = there.origin
    assert x == pytest.approx(10.0 - 4.2, abs=0.4)  # the wall was 4 m to the left, which now is back
    assert y > 0.0


def test_levels_are_those_of_map_saver_and_mean_what_they_should(tmp_path: Path) -> None:
    cells = np.array([[FREE, OCCUPIED], [UNKNOWN, FREE]], dtype=np.uint8)
    write_occupancy_grid(tmp_path / "g.yaml", OccupancyGrid(cells, 0.5, np.array([-1.0, 2.0])))
    occupied, said = read(tmp_path / "g.yaml")
    np.testing.assert_array_equal(occupied, [[np.nan, 0.0], [0.0, 1.0]])
    assert said["origin"] == [-1.0, 2.0, 0.0]


def test_no_submap_is_a_grid_of_one_unknown_cell(tmp_path: Path) -> None:
    assert build_occupancy_grid(SubmapStore(tmp_path), np.eye(4)[None]).cells.tolist() == [[UNKNOWN]]
