"""Submaps: how a drive is cut, how they follow their anchors, and how they are written."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import open3d
import pytest

from odometry import se3
from slam.errors import OutputError
from slam.keyframes import KeyFrameConfig
from slam.mapping.dense_mapper import OdometryTrajectory, group_key_frames
from slam.mapping.submaps import Submap, SubmapStore, write_mesh
from slam.mapping.tsdf import Surface

from .scenes import ahead


def surface(rng: np.random.Generator, points: int = 30) -> Surface:
    triangles = rng.integers(0, points, (points // 2, 3)).astype(np.int32)
    return Surface(
        rng.normal(size=(points, 3)).astype(np.float32), rng.integers(0, 256, (points, 3), np.uint8), triangles
    )


def filled(folder: Path, anchors: tuple[int, ...]) -> SubmapStore:
    rng, store = np.random.default_rng(0), SubmapStore(folder)
    for anchor in anchors:
        store.add(Submap(anchor, np.array([anchor]), np.eye(4)[None], surface(rng)))
    return store


def poses(seed: int, count: int) -> np.ndarray:
    return np.array([se3.exp(xi) for xi in np.random.default_rng(seed).normal(size=(count, 6))])


def test_a_corrected_graph_moves_each_submap_with_its_anchor_and_rewrites_nothing(tmp_path: Path) -> None:
    store = filled(tmp_path, (2, 5))
    files = {path: path.read_bytes() for path in tmp_path.iterdir()}
    before, after = poses(1, 6), poses(2, 6)
    for submap, old, new in zip(store, store.surfaces_in_world(before), store.surfaces_in_world(after), strict=True):
        T_after_before = after[submap.anchor] @ se3.inverse(before[submap.anchor])
        np.testing.assert_allclose(new.points, se3.transform(T_after_before, old.points), atol=1e-12)
        np.testing.assert_array_equal(new.triangles, submap.surface.triangles)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == files


def test_a_folder_that_is_gone_is_named(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"gone/000000\.npz: cannot be written"):
        filled(tmp_path / "gone", (0,))


def test_a_drive_is_cut_into_submaps_and_none_reaches_across_a_frame_that_measured_nothing() -> None:
    predicted = np.zeros(12, dtype=bool)
    predicted[[5, 6]] = True
    odometry = OdometryTrajectory(ahead(*range(12)), predicted)
    assert group_key_frames(odometry, KeyFrameConfig(), 4) == [[0, 1, 2], [3, 4], [7, 8, 9], [10, 11]]
    every_second = KeyFrameConfig(min_distance_m=2.0)
    assert group_key_frames(odometry, every_second, 4) == [[0, 2, 4], [7, 9, 11]]


def test_one_submap_at_a_time_is_in_memory(tmp_path: Path) -> None:
    """Neither the store nor the writer keeps what it has passed on."""
    import weakref

    store, seen = filled(tmp_path, (0, 1, 2, 3)), []

    def watched() -> Iterator[Surface]:
        for placed in store.surfaces_in_world(poses(0, 4)):
            seen.append(weakref.ref(placed.points))
            yield placed
            assert sum(reference() is not None for reference in seen) <= 2

    write_mesh(tmp_path / "map.ply", watched, with_triangles=True)
    assert len(seen) == 3 * 4


@pytest.mark.parametrize("with_triangles", [False, True])
def test_another_program_reads_what_is_written(tmp_path: Path, with_triangles: bool) -> None:
    store, path = filled(tmp_path, (0, 1)), tmp_path / "map.ply"
    write_mesh(path, lambda: store.surfaces_in_world(poses(3, 2)), with_triangles=with_triangles)
    placed = list(store.surfaces_in_world(poses(3, 2)))
    cloud = open3d.io.read_point_cloud(path)
    np.testing.assert_allclose(cloud.points, np.concatenate([part.points for part in placed]), atol=1e-6)
    color = np.concatenate([part.color for part in placed])
    np.testing.assert_allclose(cloud.colors, color / 255.0, atol=1e-6)
    if with_triangles:
        corners = np.asarray(cloud.points)[np.asarray(open3d.io.read_triangle_mesh(path).triangles)]
        expected = np.concatenate([part.points[part.triangles] for part in placed])
        np.testing.assert_allclose(corners, expected, atol=1e-6)


def test_a_drive_that_shows_nothing_is_an_empty_file(tmp_path: Path) -> None:
    write_mesh(tmp_path / "map.ply", lambda: iter(()), with_triangles=True)
    assert b"element vertex 0\n" in (tmp_path / "map.ply").read_bytes()
