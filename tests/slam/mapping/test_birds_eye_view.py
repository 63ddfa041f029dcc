"""A map from above: of each cell the highest point, in whatever order points come."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from slam.mapping.birds_eye_view import PlaneWindow, render_birds_eye_view
from slam.mapping.tsdf import Surface

WINDOW = PlaneWindow(left=-3.0, top=4.0, cell_m=0.5, shape=(10, 12))
POINTS = arrays(np.float64, st.tuples(st.integers(0, 60), st.just(3)), elements=st.floats(-6, 6, width=32))


def surface(points: np.ndarray) -> Surface:
    color = np.arange(len(points))[:, None] * [1, 2, 3] % 256
    return Surface(points, color.astype(np.uint8), np.zeros((0, 3), np.int32))


@given(POINTS, POINTS)
def test_each_cell_shows_the_highest_of_its_points(first: np.ndarray, second: np.ndarray):
    surfaces = [surface(first), surface(second)]
    view = render_birds_eye_view(iter(surfaces), WINDOW)
    highest: dict[tuple[int, int], float] = {}
    colors: dict[tuple[int, int, float], set[tuple[int, ...]]] = {}
    for part in surfaces:
        for (x, y, z), color in zip(part.points.astype(float), part.color, strict=True):
            row, column = int((4.0 - z) // 0.5), int((x + 3.0) // 0.5)
            if 0 <= row < 10 and 0 <= column < 12:
                highest[row, column] = max(highest.get((row, column), -np.inf), -y)
                colors.setdefault((row, column, -y), set()).add(tuple(color.tolist()))
    assert {tuple(cell) for cell in np.argwhere(np.isfinite(view.height)).tolist()} == set(highest)
    for cell, up in highest.items():
        assert view.height[cell] == up
        assert tuple(view.color[cell].tolist()) in colors[*cell, up]


def test_x_is_to_the_right_and_z_up():
    view = render_birds_eye_view([surface(np.array([[2.9, 0.0, 3.9]], np.float32))], WINDOW)
    assert np.argwhere(np.isfinite(view.height)).tolist() == [[0, 11]]


def test_what_is_above_a_height_hides_nothing():
    points = np.array([[0.1, -2.5, 0.1], [0.1, 0.4, 0.1], [0.1, 1.0, 0.1]], np.float32)
    row, column = np.argwhere(np.isfinite(render_birds_eye_view([surface(points)], WINDOW).height))[0]
    for max_height_m, height in ((np.inf, 2.5), (1.0, -0.4), (-0.5, -1.0)):
        view = render_birds_eye_view([surface(points)], WINDOW, max_height_m)
        assert view.height[row, column] == np.float32(height)


def test_a_window_holds_all_positions_with_their_margin_and_never_too_many_cells():
    rng = np.random.default_rng(0)
    for size in (0.0, 10.0, 5000.0):
        positions = size * rng.random((50, 3))
        window = PlaneWindow.around(positions, 25.0, 0.2)
        corners = positions[:, None] + np.array([[-24.9, 0, -24.9], [24.9, 0, 24.9]])
        assert window.contains(window.cells(corners.reshape(-1, 3))).all()
        assert max(window.shape) <= 1201
        assert window.cell_m >= 0.2
