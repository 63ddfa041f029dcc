"""The page of a dense map: self-contained, and its pictures lie as the map does."""

import base64
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from slam.errors import OutputError
from slam.mapping.birds_eye_view import BirdsEyeView, PlaneWindow
from slam.mapping.occupancy_grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from slam.report.dense_map_section import (
    DenseOverview,
    colour_heights,
    is_without_color,
    paint_colors,
    round_length,
    write_dense_page,
)
from slam.report.html_report import write_report

from . import fabricate
from .test_html_report import Page

WHOLE = fabricate.record(40)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "dense.html"


def images(page: Path) -> list[np.ndarray]:
    found = re.findall(r'<image href="data:image/webp;base64,([^"]+)"', page.read_text(encoding="utf-8"))
    return [cv2.imdecode(np.frombuffer(base64.b64decode(one), np.uint8), cv2.IMREAD_UNCHANGED) for one in found]


def test_the_page_has_both_maps_and_the_grid_and_asks_for_no_other_file(path: Path):
    fabricate.write_dense(path, WHOLE)
    page = Page(path.read_text(encoding="utf-8"))
    assert len(images(path)) == 3
    assert len(page.ids()) == len(set(page.ids()))
    assert "Before: dense map by odometry" in page.text
    assert "After: dense map, loops closed" in page.text


def test_the_same_maps_give_the_same_bytes(path: Path):
    fabricate.write_dense(path, WHOLE)
    first = path.read_bytes()
    fabricate.write_dense(path, WHOLE)
    assert path.read_bytes() == first


def test_the_report_links_to_the_page_only_if_the_run_can_have_one(tmp_path: Path):
    for dense_page in (None, "dense.html"):
        write_report(WHOLE, tmp_path / "report.html", dense_page=dense_page)
        page = (tmp_path / "report.html").read_text(encoding="utf-8")
        assert ('<a href="dense.html">' in page) == (dense_page is not None)


def test_a_folder_that_is_gone_is_named(tmp_path: Path):
    with pytest.raises(OutputError, match=r"gone/dense\.html: cannot be written"):
        fabricate.write_dense(tmp_path / "gone" / "dense.html", WHOLE)


def test_in_the_grid_ahead_is_up_and_left_is_left(path: Path):
    """Its own frame has x ahead and y to the left: the last column is farthest ahead, the first row leftmost."""
    cells = np.full((40, 60), UNKNOWN, np.uint8)
    cells[:10, 50:] = OCCUPIED  # ahead, to the left
    cells[30:, 50:] = FREE  # ahead, to the right
    fabricate.write_dense(path, WHOLE, OccupancyGrid(cells, 0.5, np.array([-5.0, -8.0])))
    plan = images(path)[2]
    assert plan.shape[:2] == (60, 40)
    assert plan[3, 3].max() < 20
    assert plan[3, 36].min() > 230
    assert 180 < plan[50, 20].mean() < 230


def test_the_path_is_drawn_where_it_is_in_the_picture(path: Path):
    fabricate.write_dense(path, WHOLE)
    window = fabricate.dense_window(WHOLE)
    start = re.search(r'<polyline class="before" points="([\d.]+),([\d.]+)', path.read_text(encoding="utf-8"))
    assert start is not None
    left, below = map(float, start.groups())
    assert (window.left + left, window.top - below) == pytest.approx((0.0, 0.0), abs=0.06)


def test_height_is_hue_and_what_is_not_known_is_clear():
    view = fabricate.top_view(np.array([[np.nan, 0.0, 1.0, 2.0, 9.0]], np.float32))
    image = colour_heights(view, 0.0, 2.0)[0]
    assert image[:, 3].tolist() == [0, 255, 255, 255, 255]
    assert len(np.unique(image[1:4, :3], axis=0)) == 3
    assert (image[3] == image[4]).all()


def test_colors_of_the_images_are_shown_as_they_are():
    view = fabricate.top_view(np.array([[np.nan, 0.0]], np.float32))
    assert is_without_color(view.color)
    view.color[:] = [200, 10, 90]
    assert not is_without_color(view.color)
    assert paint_colors(view)[0].tolist() == [[90, 10, 200, 0], [90, 10, 200, 255]]


@pytest.mark.parametrize(("most", "length"), [(1.0, 1.0), (33.0, 20.0), (99.9, 50.0), (100.0, 100.0), (0.07, 0.05)])
def test_a_scale_has_a_round_length(most: float, length: float):
    assert round_length(most) == pytest.approx(length)


@pytest.mark.parametrize("channels", [1, 3], ids=["grey", "colour"])
def test_the_page_is_small_for_any_map(path: Path, channels: int):
    """Noise, which nothing compresses, takes less than 3 MB."""
    fabricate.write_dense(path, WHOLE)
    rng, size = np.random.default_rng(0), path.stat().st_size
    window, shape = PlaneWindow(0.0, 0.0, 1.0, (1200, 1200)), (1200, 1200)
    color = np.zeros((*shape, 3), np.uint8) + rng.integers(0, 256, (*shape, channels), np.uint8)
    views = [BirdsEyeView(rng.normal(size=shape).astype(np.float32), color) for _ in range(2)]
    maps = [DenseOverview(*both, WHOLE.odometry[:, :3, 3]) for both in zip(("before", "after"), views, strict=True)]
    grid = OccupancyGrid(rng.choice(np.array([FREE, OCCUPIED, UNKNOWN], np.uint8), (3000, 3000)), 0.2, np.zeros(2))
    write_dense_page(path, maps, window, grid)
    assert path.stat().st_size - size < 3_000_000
