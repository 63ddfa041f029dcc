import numpy as np
import pytest

from slam.simulation.rendering.light_volume import LightSource, bake_light
from slam.simulation.world.furniture import blocks
from slam.simulation.world.mesh import merge_meshes, panel

FLOOR = np.array([[0.0, 0.0, 4.0, 4.0]])
HEIGHT = 2.6
LAMP = LightSource(np.array([[1.0, 2.0, 2.4]]), np.zeros(3), 1.0)


def shell():
    """Walls, floor and ceiling of an empty room."""
    x, y, z = np.diag([4.0, 4.0, HEIGHT])
    return [
        panel(o, a, b, 0, (0, 0, 1, 1))
        for o, a, b in ((0 * x, x, y), (z, x, y), (0 * x, x, z), (y, x, z), (0 * x, y, z), (x, y, z))
    ]


def light_at(volume, side, x, y, z):
    index = np.rint((np.array([x, y, z]) - volume.origin) / volume.cell_m).astype(int)
    return float(volume.light[side, index[2], index[1], index[0]])


def bake(extra=()):
    return bake_light(merge_meshes([*shell(), *extra]).corners, [LAMP], FLOOR, HEIGHT)


UP, TO_LAMP, FROM_LAMP = 4, 1, 0  # surfaces that face +z, -x and +x


def test_light_falls_off_with_distance_and_with_the_angle():
    volume = bake()
    floor = [light_at(volume, UP, x, 2.0, 0.15) for x in (1.0, 2.0, 3.0)]
    assert floor[0] > floor[1] > floor[2]
    assert light_at(volume, TO_LAMP, 3.0, 2.0, 1.5) > 1.3 * light_at(volume, FROM_LAMP, 3.0, 2.0, 1.5)


def test_what_stands_before_the_lamp_throws_a_shadow():
    plate = blocks([1.6, 1.0, 1.2], [1.65, 3.0, 2.5], 0)
    free, shaded = bake(), bake([plate])
    # The mean of the room stays the same, so compare with a place that still sees the lamp.
    ratios = [light_at(v, UP, 2.4, 2.0, 0.9) / light_at(v, UP, 0.6, 2.0, 0.9) for v in (free, shaded)]
    assert ratios[1] < 0.75 * ratios[0]


def test_no_darkness_leaks_out_of_a_closed_box_or_from_behind_a_wall():
    box = blocks([2.0, 1.5, 0.0], [2.6, 2.5, 0.8], 0)
    volume = bake([box])
    assert light_at(volume, UP, 2.3, 2.0, 0.4) > 0.4 * light_at(volume, UP, 1.4, 2.0, 0.4)
    assert light_at(volume, UP, 0.0, 2.0, 1.0) > 0.6 * light_at(volume, UP, 0.3, 2.0, 1.0)


def test_the_mean_light_does_not_depend_on_the_lamps():
    brighter = LightSource(LAMP.points, LAMP.facing, 10.0)
    corners = merge_meshes(shell()).corners
    one, ten = (bake_light(corners, [lamp], FLOOR, HEIGHT).light for lamp in (LAMP, brighter))
    np.testing.assert_allclose(one, ten, rtol=1e-5)
    assert one.mean() == pytest.approx(0.8, abs=0.15)
