"""Textures are filtered by the pixel's footprint, and light obeys sun, sky and distance."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slam.simulation.rendering.renderer import build_scene
from slam.simulation.rendering.shading import (
    Footprint,
    Lighting,
    SampleBuffers,
    ShadowMap,
    Surfaces,
    Viewpoint,
    _footprint,
    _sunlit,
    sample_anisotropic,
    sample_isotropic,
    shade,
)
from slam.simulation.world.mesh import quads
from slam.simulation.world.textures import build_atlas

Sample = Callable[..., float]


def footprint(u: float, v: float, short: float, long: float, along_u: bool = True) -> Footprint:
    return Footprint(u, v, long if along_u else 0.0, 0.0 if along_u else long, short, long)


@pytest.mark.parametrize("sample", [sample_anisotropic, sample_isotropic])
@settings(max_examples=30, deadline=None)
@given(u=st.floats(-3, 3), v=st.floats(-3, 3), short=st.floats(1e-4, 0.5), ratio=st.floats(1, 30))
def test_a_uniform_texture_is_uniform_under_any_footprint(
    sample: Sample, u: float, v: float, short: float, ratio: float
) -> None:
    atlas = build_atlas([(np.full((64, 64), 0.6), None)])
    assert sample(atlas.texels, 0, 6, footprint(u, v, short, ratio * short)) == pytest.approx(153 / 255, abs=1e-5)


@pytest.mark.parametrize("sample", [sample_anisotropic, sample_isotropic])
def test_textures_repeat(sample: Sample) -> None:
    atlas = build_atlas([(np.random.default_rng(0).random((64, 64)), None)])
    for shift in (1, -2):
        one = sample(atlas.texels, 0, 6, footprint(0.3, 0.7, 0.02, 0.05))
        other = sample(atlas.texels, 0, 6, footprint(0.3 + shift, 0.7 - shift, 0.02, 0.05))
        assert one == pytest.approx(other, abs=1e-5)


def test_a_small_footprint_reads_the_texel_and_a_large_one_the_mean() -> None:
    image = np.random.default_rng(1).random((64, 64))
    atlas = build_atlas([(image, None)])
    at = (20 + 0.5) / 64, (33 + 0.5) / 64  # centre of a texel
    assert sample_anisotropic(atlas.texels, 0, 6, footprint(*at, 1e-3, 1e-3)) == pytest.approx(image[33, 20], abs=0.005)
    assert sample_anisotropic(atlas.texels, 0, 6, footprint(*at, 1.0, 1.0)) == pytest.approx(image.mean(), abs=0.02)


def test_a_long_footprint_averages_along_its_axis_alone() -> None:
    stripes = np.tile(((np.arange(64) // 8) % 2).astype(float), (64, 1))  # change along u, constant along v
    atlas = build_atlas([(stripes, None)])
    at, short, long = ((4 + 0.5) / 64, 0.5), 1.0 / 64, 16.0 / 64
    along, across = (sample_anisotropic(atlas.texels, 0, 6, footprint(*at, short, long, u)) for u in (True, False))
    assert abs(along - 0.5) < 0.2  # a whole period
    assert across < 0.1  # stays within its stripe


def ground(size: float = 400.0) -> np.ndarray:
    """Attributes (T, 12) of a square on the ground whose texture has a tile for each metre."""
    square = size * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    return build_scene([quads(square[None], square[None, :, :2], 0)]).attributes


@settings(max_examples=50, deadline=None)
@given(elevation=st.floats(5.0, 85.0), azimuth=st.floats(0.0, 360.0), height=st.floats(0.5, 30.0))
def test_the_footprint_on_the_ground_is_as_wide_as_the_cone_and_longer_by_the_slope(
    elevation: float, azimuth: float, height: float
) -> None:
    e, a = np.radians([elevation, azimuth])
    ray = (np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), -np.sin(e))
    distance = height / np.sin(e)
    point = (distance * ray[0], distance * ray[1], 0.0)
    width = 0.001 * distance
    found = Footprint(*_footprint(ray, point, width, ground(), 0))
    assert found.short == pytest.approx(width, rel=1e-3)
    assert found.long == pytest.approx(width / np.sin(e), rel=1e-3)
    np.testing.assert_allclose([found.u, found.v], point[:2], atol=1e-3)
    along = np.array([found.du, found.dv]) / found.long
    if elevation < 80:  # from above, the footprint is round and its axis arbitrary
        assert abs(along @ [np.cos(a), np.sin(a)]) == pytest.approx(1.0, abs=1e-3)


def test_a_point_is_in_the_shadow_of_what_is_nearer_to_the_sun() -> None:
    heights = np.full((10, 10), 5.0, np.float32)
    shadow = (np.eye(3), np.zeros(2), 1.0, heights)
    assert _sunlit((4.2, 4.7, 5.0), *shadow) == 1.0
    assert _sunlit((4.2, 4.7, 4.0), *shadow) == 0.0
    assert _sunlit((40.0, 4.7, 4.0), *shadow) == 1.0  # outside of the map


def test_the_border_of_a_shadow_is_a_gradient() -> None:
    heights = np.zeros((10, 10), np.float32)
    heights[:, 5:] = 9.0
    light = [_sunlit((x, 4.0, 1.0), np.eye(3), np.zeros(2), 1.0, heights) for x in (3.5, 4.25, 4.5, 4.75, 5.5)]
    np.testing.assert_allclose(light, [1.0, 0.75, 0.5, 0.25, 0.0])


def picture(height: float = 10.0, sun: float = 1.0, haze: float = 0.7) -> tuple[np.ndarray, np.ndarray]:
    """Light and depth of a uniform ground, seen from above by a camera that looks straight down."""
    shape, atlas = (12, 16), build_atlas([(np.full((16, 16), 0.5), None)])
    view = Viewpoint(np.array([[0.02, 0, -0.15], [0, -0.02, 0.11], [0, 0, -1.0]]), np.array([0.0, 0, height]), 0.02)
    material = np.zeros((1, 7))
    surfaces = Surfaces(ground(), np.zeros(2, np.int32), material, atlas.texels, atlas.gloss, atlas.table)
    open_map = ShadowMap(np.eye(3), np.zeros(2), 1.0, np.full((4, 4), -np.inf, np.float32))
    panorama = np.full((64, 128), 0.8, np.float32)
    lighting = Lighting(np.array([0.0, 0.0, 1.0]), sun, 0.4, haze, panorama, open_map)
    inverse_depth = np.full((*shape, 4), 1.0 / height, np.float32)
    ids = np.zeros((*shape, 4), np.int32)
    inverse_depth[0], ids[0] = 0.0, -1  # a row of sky
    light, depth = np.empty(shape, np.float32), np.empty(shape, np.float32)
    shade(SampleBuffers(inverse_depth, ids), view, surfaces, lighting, light, depth)
    return light, depth


def test_the_sky_is_the_panorama_and_infinitely_far() -> None:
    light, depth = picture()
    np.testing.assert_allclose(light[0], 0.8, rtol=1e-6)
    assert np.isinf(depth[0]).all()
    np.testing.assert_allclose(depth[1:], 10.0, rtol=1e-6)


def test_light_is_albedo_times_sun_and_sky() -> None:
    light, _ = picture(height=1.0, haze=0.0)
    fade = np.exp(-1.0 / 900.0)
    albedo = 127 / 255  # of half brightness in eight bits
    np.testing.assert_allclose(light[1:], albedo * (1.0 + 0.4) * fade, rtol=0.01)
    brighter, _ = picture(height=1.0, haze=0.0, sun=2.0)
    np.testing.assert_allclose(brighter[1:] - light[1:], albedo * fade, rtol=0.01)


def test_far_ground_fades_into_haze() -> None:
    near, middle, far = (picture(height, haze=0.3)[0][5, 5] for height in (1.0, 900.0, 9000.0))
    assert far == pytest.approx(0.3, abs=1e-3)
    assert (middle - far) / (near - far) == pytest.approx(np.exp(-1), rel=0.02)


def test_a_pixel_on_an_edge_mixes_both_surfaces_and_has_the_depth_of_the_nearer() -> None:
    shape, atlas = (1, 1), build_atlas([(np.full((16, 16), 0.5), None)])
    view = Viewpoint(np.array([[0.02, 0, 0.0], [0, -0.02, 0.0], [0, 0, -1.0]]), np.array([0.0, 0, 10.0]), 0.02)
    surfaces = Surfaces(ground(), np.zeros(2, np.int32), np.zeros((1, 7)), atlas.texels, atlas.gloss, atlas.table)
    open_map = ShadowMap(np.eye(3), np.zeros(2), 1.0, np.full((4, 4), -np.inf, np.float32))
    lighting = Lighting(np.array([0.0, 0, 1.0]), 1.0, 0.4, 0.7, np.full((64, 128), 0.2, np.float32), open_map)

    def seen(ids: list[int]) -> tuple[float, float]:
        light, depth = np.empty(shape, np.float32), np.empty(shape, np.float32)
        near = np.array([[[0.1 if t >= 0 else 0.0 for t in ids]]], np.float32)
        shade(SampleBuffers(near, np.array([[ids]], np.int32)), view, surfaces, lighting, light, depth)
        return float(light[0, 0]), float(depth[0, 0])

    (full, _), (sky, _) = seen([0, 0, 0, 0]), seen([-1, -1, -1, -1])
    mixed, depth = seen([0, -1, 0, 0])
    assert mixed == pytest.approx(0.75 * full + 0.25 * sky, rel=1e-4)
    assert depth == pytest.approx(10.0, rel=1e-5)
