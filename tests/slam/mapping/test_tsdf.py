"""Surfaces fused from depth of known geometry."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from odometry import se3
from slam.errors import RevisitError
from slam.mapping.tsdf import FusionConfig, Surface, TsdfVolume

from .scenes import CAMERA_HEIGHT, ahead, seen


def fused(poses: np.ndarray, config: FusionConfig | None = None) -> Surface:
    volume = TsdfVolume(config or FusionConfig())
    for T in poses:
        volume.integrate(seen(T), T)
    return volume.extract_surface()


def test_road_and_wall_come_out_where_they_are() -> None:
    surface = fused(ahead(*range(12)))
    x, y, _ = surface.points.T
    road = np.abs(y - CAMERA_HEIGHT)
    wall = np.where(y > CAMERA_HEIGHT - 3.15, np.abs(x + 4.0), np.inf)
    off = np.minimum(road, wall)
    assert len(surface.points) > 5000
    assert np.median(off) < 0.03
    assert np.percentile(off, 99) < 0.1
    assert (road < 0.1).sum() > 1000
    assert (wall < 0.1).sum() > 1000


def test_it_does_not_matter_where_the_anchor_stands() -> None:
    """The field lies on other voxels then, and so the same plane is met at other points."""
    T_anchor_first = se3.exp(np.array([0.1, 0.7, -0.2, 3.0, -1.0, 2.0]))
    volume = TsdfVolume(FusionConfig())
    for T in ahead(*range(8)):
        volume.integrate(seen(T), T_anchor_first @ T)
    points = volume.extract_surface().transform(se3.inverse(T_anchor_first)).points
    off = np.minimum(np.abs(points[:, 1] - CAMERA_HEIGHT), np.abs(points[:, 0] + 4.0))
    assert np.median(off) < 0.02


def test_what_too_few_images_saw_is_left_out() -> None:
    config = FusionConfig(min_views=3)
    assert fused(ahead(0, 1), config).points.shape == (0, 3)
    assert len(fused(ahead(0, 1, 2), config).points) > 1000


def test_a_thing_that_moves_on_leaves_nothing() -> None:
    """A car 8 m ahead that drives as fast as we do: each place has seen it in fewer images than a point needs."""
    volume, poses = TsdfVolume(FusionConfig()), ahead(*range(0, 20, 2))
    for T in poses:
        image = seen(T)
        depth = image.depth.copy()
        depth[80:130, 270:350] = 8.0
        volume.integrate(replace(image, depth=depth), T)
    x, y, _ = volume.extract_surface().points.T
    assert not ((np.abs(x) < 1.0) & (y < CAMERA_HEIGHT - 0.5)).any()


def test_two_fusions_give_the_same_bits_although_threads_race() -> None:
    first, second = (fused(ahead(*range(6))) for _ in range(2))
    np.testing.assert_array_equal(first.points, second.points)
    np.testing.assert_array_equal(first.color, second.color)
    np.testing.assert_array_equal(first.triangles, second.triangles)


def test_triangles_face_the_cameras() -> None:
    surface = fused(ahead(*range(8)))
    a, b, c = (surface.points[surface.triangles[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    flat = np.abs(a[:, 1] - CAMERA_HEIGHT) < 0.05
    assert (normals[flat, 1] < 0).mean() > 0.99  # y points down


def test_grey_is_what_the_images_show() -> None:
    surface = fused(np.repeat(np.eye(4)[None], 5, axis=0))
    middle = np.abs(surface.points[:, 2] - 7.0) < 0.5
    row = 359.4 * surface.points[middle, 1] / surface.points[middle, 2] + 93.5
    assert np.median(np.abs(surface.color[middle, 0] - row)) < 3.0


def test_colors_are_those_of_the_images() -> None:
    volume = TsdfVolume(FusionConfig())
    for T in np.repeat(np.eye(4)[None], 5, axis=0):
        image = seen(T)
        color = np.broadcast_to(np.array([200, 10, 90], np.uint8), image.color.shape)
        volume.integrate(replace(image, color=color), T)
    assert (volume.extract_surface().color == [200, 10, 90]).all()


def test_nothing_seen_is_an_empty_surface() -> None:
    image = seen(np.eye(4))
    volume = TsdfVolume(FusionConfig())
    volume.integrate(replace(image, depth=np.zeros_like(image.depth)), np.eye(4))
    surface = volume.extract_surface()
    assert surface.points.shape == surface.triangles.shape == (0, 3)
    assert surface.transform(np.eye(4)).points.shape == (0, 3)


@pytest.mark.parametrize("voxel_m", [0.0, -1.0, np.nan, np.inf])
def test_a_config_that_cannot_work_is_refused(voxel_m: float) -> None:
    with pytest.raises(ValueError, match="positive"):
        FusionConfig(voxel_m=voxel_m)


def test_where_open3d_does_not_load_one_line_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(RevisitError, match=r"open3d: .*; type: revisit doctor"):
        TsdfVolume(FusionConfig())
