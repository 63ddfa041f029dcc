import numpy as np
import pytest

from slam.simulation.scenario.room_config import RoomConfig
from slam.simulation.world import furniture
from slam.simulation.world.room import DOOR_WIDTH_M, build_room
from slam.simulation.world.room_materials import PAPERS, PICTURES, SCREENS, SPINES, RoomSurface, build_room_materials

SEEDS = range(1, 6)
PIECES = sorted(set(furniture.WALL_PIECES) | {furniture.table, furniture.low_table}, key=lambda build: build.__name__)


def corners_of(room):
    return np.concatenate([mesh.corners for mesh in room.meshes])


def test_another_seed_gives_another_room():
    sizes = {tuple(build_room(seed).floors[0, 2:].round(3)) for seed in SEEDS}
    assert len(sizes) == len(SEEDS)


def test_the_same_seed_gives_the_same_room():
    first = corners_of(build_room(3))
    build_room.cache_clear()
    np.testing.assert_array_equal(first, corners_of(build_room(3)))


@pytest.mark.parametrize("seed", SEEDS)
def test_measures_of_a_room(seed: int):
    room = build_room(seed)
    length, width = room.floors[0, 2:]
    assert 4.0 <= min(length, width) <= max(length, width) <= 8.0
    assert 2.5 <= room.height <= 3.0
    assert len(room.obstacles) > 8
    corners = corners_of(room)
    assert corners[:, :, 2].min() >= 0.0
    assert corners[:, :, 2].max() <= room.height + 1e-9


@pytest.mark.parametrize("seed", SEEDS)
def test_what_stands_in_a_room_is_in_an_obstacle_and_no_two_meet(seed: int):
    room = build_room(seed)
    standing = room.obstacles[(room.obstacles[:, 0, 2] == 0.0) & (np.ptp(room.obstacles, axis=1)[:, 2] > 0.2)]
    # Curtains hang before the radiator, and chairs stand under the table: both are tested by the eye.
    size = np.ptp(standing, axis=1)
    standing = standing[(size[:, 0] > 0.28) & (size[:, 1] > 0.28) & (size[:, 2] > 0.95)]
    for i, (low, high) in enumerate(standing):
        for other_low, other_high in standing[:i]:
            assert (low[:2] >= other_high[:2] - 1e-6).any() or (other_low[:2] >= high[:2] - 1e-6).any()


@pytest.mark.parametrize("seed", SEEDS)
def test_the_door_is_open_and_free(seed: int):
    room = build_room(seed)
    low = room.door - np.array([DOOR_WIDTH_M / 2 - 0.01, 1.4])
    high = room.door + np.array([DOOR_WIDTH_M / 2 - 0.01, 0.2])
    for a, b in room.obstacles:
        assert a[2] > 2.0 or (b[:2] <= low + 0.02).any() or (a[:2] >= high - 0.02).any()
    # No triangle crosses the middle of the doorway.
    corners = corners_of(room)
    crosses = (corners[:, :, 1].min(axis=1) < room.door[1]) & (corners[:, :, 1].max(axis=1) > room.door[1])
    crosses &= (corners[:, :, 0].min(axis=1) < room.door[0]) & (corners[:, :, 0].max(axis=1) > room.door[0])
    crosses &= (corners[:, :, 2].max(axis=1) > 0.02) & (corners[:, :, 2].min(axis=1) < 2.0)
    assert not crosses.any()


@pytest.mark.parametrize("build", PIECES, ids=lambda build: build.__name__)
def test_furniture_stands_on_the_floor_within_its_footprint(build):
    for seed in range(3):
        piece = build(np.random.default_rng(seed))
        low, high = piece.mesh.corners.min(axis=(0, 1)), piece.mesh.corners.max(axis=(0, 1))
        assert low[2] == pytest.approx(0.0, abs=1e-9)
        np.testing.assert_allclose(high, piece.size * [0.5, 0.5, 1.0], atol=1e-9)
        np.testing.assert_allclose(low[:2], -piece.size[:2] / 2, atol=1e-9)


def test_blocks_are_closed_below():
    mesh = furniture.blocks([0, 0, 0], [1, 2, 3], 0)
    a, b, c = mesh.corners.transpose(1, 0, 2)
    normals = np.cross(b - a, c - a) / 2
    np.testing.assert_allclose(normals.sum(axis=0), 0.0, atol=1e-12)  # the areas of a closed surface cancel
    volume = (a * np.cross(b, c)).sum() / 6
    assert volume == pytest.approx(6.0)


def test_the_table_of_materials_has_a_row_for_each_texture():
    materials = build_room_materials(1)
    assert len(materials.table) == RoomSurface.SCREEN + SCREENS
    assert RoomSurface.PICTURE == RoomSurface.CARTON + 1
    assert RoomSurface.SPINE - RoomSurface.PICTURE == PICTURES
    assert RoomSurface.PAPER - RoomSurface.SPINE == SPINES
    assert RoomSurface.SCREEN - RoomSurface.PAPER == PAPERS
    assert (materials.table[RoomSurface.SCREEN :, 8] == 0).all()
    used = np.concatenate([mesh.material for mesh in build_room(1).meshes])
    assert used.max() < len(materials.table)


def test_white_walls_have_little_texture_and_pictures_have_much():
    atlas = build_room_materials(1).atlas

    def contrast(surface):
        power, _, start = atlas.table[surface]
        return atlas.texels[start : start + 4**power].std()

    assert contrast(RoomSurface.WALL) < 4
    assert min(contrast(RoomSurface.PICTURE + k) for k in range(PICTURES)) > 15


def test_generators_of_a_room_are_independent():
    config = RoomConfig(seed=4)
    assert config.rng(1).random() != config.rng(2).random()
    assert config.rng(1).random() == config.rng(1).random()
