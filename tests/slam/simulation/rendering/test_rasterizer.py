"""A rasteriser draws what a ray through each sample meets first, and shadows fall where the sun does not reach."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slam.simulation.rendering.rasterizer import SAMPLE_X, SAMPLE_Y, SAMPLES, rasterize, rasterize_from_sun

SIZE = (24, 32)  # rows, columns
P = np.array([[20.0, 0.0, 15.5, 0.0], [0.0, 20.0, 11.5, 0.0], [0.0, 0.0, 1.0, 0.0]])


def draw(corners: np.ndarray, order: list[int] | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Inverse depth and triangle of each sample, triangles drawn in an order."""
    inverse_depth = np.zeros((*SIZE, SAMPLES), np.float32)
    ids = np.full((*SIZE, SAMPLES), -1, np.int32)
    ranges = np.array([[t, t + 1] for t in order or range(len(corners))])
    rasterize(np.ascontiguousarray(corners, np.float32), ranges, P, inverse_depth, ids)
    return inverse_depth, ids


def random_triangles(seed: int, count: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    middles = np.column_stack([rng.uniform(-4, 4, count), rng.uniform(-3, 3, count), rng.uniform(2, 20, count)])
    return middles[:, None] + rng.normal(0, 1.5, (count, 3, 3)) * [1.0, 1.0, 0.3]


def first_hits(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same by an intersection of each ray with each triangle, and how far from any edge each ray passes."""
    v, u = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
    x = (u[..., None] + SAMPLE_X - P[0, 2]) / P[0, 0]
    y = (v[..., None] + SAMPLE_Y - P[1, 2]) / P[1, 1]
    rays = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)
    near, ids, margin = np.zeros(len(rays)), np.full(len(rays), -1), np.full(len(rays), np.inf)
    for t, triangle in enumerate(corners.astype(np.float32).astype(float)):
        M = triangle.T
        if abs(np.linalg.det(M)) < 1e-6:
            continue
        weights = np.linalg.solve(M, rays.T).T  # a ray is a sum of the corners: all weights positive means inside
        inverse = weights.sum(axis=1)
        margin = np.minimum(margin, np.abs(weights).min(axis=1))
        hit = (weights > 0).all(axis=1) & (inverse > near)
        near[hit], ids[hit] = inverse[hit], t
    return ids.reshape(*SIZE, SAMPLES), margin.reshape(*SIZE, SAMPLES)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), count=st.integers(1, 8))
def test_each_sample_shows_the_first_triangle_on_its_ray(seed: int, count: int) -> None:
    corners = random_triangles(seed, count)
    if corners[:, :, 2].min() < 0.3:  # the near plane has a test of its own
        return
    _, ids = draw(corners)
    expected, margin = first_hits(corners)
    clear = margin > 1e-4
    np.testing.assert_array_equal(ids[clear], expected[clear])


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_the_order_of_drawing_changes_nothing(seed: int) -> None:
    corners = random_triangles(seed, 6)
    forward, backward = draw(corners), draw(corners, list(range(5, -1, -1)))
    np.testing.assert_array_equal(forward[0], backward[0])
    np.testing.assert_array_equal(forward[1], backward[1])


def test_inverse_depth_is_that_of_the_plane() -> None:
    square = np.array([[-9.0, -9, 4], [9, -9, 8], [9, 9, 8], [-9, 9, 4]])
    inverse_depth, ids = draw(np.stack([square[[0, 1, 2]], square[[0, 2, 3]]]))
    assert (ids >= 0).all()  # no crack between the two triangles
    x = (np.arange(SIZE[1])[None, :, None] + np.array(SAMPLE_X) - P[0, 2]) / P[0, 0]
    expected = (1 - x * 4 / 18) / 6.0  # z = 6 + 4 x_metres / 18 with x_metres = x z
    np.testing.assert_allclose(inverse_depth, np.broadcast_to(expected, inverse_depth.shape), rtol=1e-5)


def test_a_triangle_that_reaches_behind_the_camera_is_drawn_without_clipping() -> None:
    ground = np.array([[[-50.0, 1.5, -20.0], [50.0, 1.5, -20.0], [0.0, 1.5, 400.0]]])
    inverse_depth, ids = draw(ground)
    below = np.arange(SIZE[0]) > P[1, 2] + 2
    assert (ids[below] == 0).all()
    assert (ids[np.arange(SIZE[0]) < P[1, 2] - 1] == -1).all()
    y = (np.arange(SIZE[0])[below, None] + np.array(SAMPLE_Y) - P[1, 2]) / P[1, 1]
    np.testing.assert_allclose(inverse_depth[below][:, 16], y / 1.5, rtol=1e-5)


@pytest.mark.parametrize("z", [-5.0, 0.05])
def test_triangles_behind_or_at_the_camera_are_not_drawn(z: float) -> None:
    _, ids = draw(np.array([[[-1.0, -1, z], [1, -1, z], [0, 1, z]]]))
    assert (ids == -1).all()


def test_the_sun_sees_the_highest_surface() -> None:
    low = np.array([[[-5.0, -5, 1], [5, -5, 1], [0, 8, 1]]])
    high = np.array([[[-1.0, -1, 3], [1, -1, 3], [0, 1, 3]]])
    heights = np.full((60, 60), -np.inf, np.float32)
    triangles = np.concatenate([high, low]).astype(np.float32)
    rasterize_from_sun(triangles, np.eye(3), np.array([-6.0, -6.0]), 0.2, heights)
    assert heights[30, 30] == pytest.approx(3.0)
    assert heights[15, 30] == pytest.approx(1.0)
    assert heights[0, 0] == -np.inf


def test_heights_follow_a_slope() -> None:
    slope = np.array([[[0.0, 0, 0], [10, 0, 5], [0, 10, 0]]], np.float32)
    heights = np.full((20, 20), -np.inf, np.float32)
    rasterize_from_sun(slope, np.eye(3), np.zeros(2), 0.5, heights)
    inside = np.isfinite(heights)
    columns = np.broadcast_to(np.arange(20), (20, 20))
    np.testing.assert_allclose(heights[inside], 0.25 * columns[inside], atol=1e-5)
    assert inside.sum() > 180
