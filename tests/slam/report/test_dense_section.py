"""The dense map in the report: put into its own place, once, and drawn as it lies."""

import base64
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from slam.errors import DataError
from slam.mapping.occupancy import FREE, OCCUPIED, UNKNOWN, Grid
from slam.mapping.top_view import TopView, Window
from slam.report.dense_section import Overview, coloured, round_length, show_dense_map
from slam.report.page import write_report

from . import fabricate
from .test_page import Page

WHOLE = fabricate.record(40)


@pytest.fixture
def report(tmp_path: Path) -> Path:
    write_report(replace(WHOLE, name="<!-- dense map -->"), tmp_path / "report.html")
    return tmp_path / "report.html"


def images(report: Path) -> list[np.ndarray]:
    found = re.findall(r'<image href="data:image/webp;base64,([^"]+)"', report.read_text(encoding="utf-8"))
    return [cv2.imdecode(np.frombuffer(base64.b64decode(one), np.uint8), cv2.IMREAD_UNCHANGED) for one in found]


def test_the_map_gets_a_section_and_the_rest_of_the_page_stays(report: Path):
    before = report.read_text(encoding="utf-8")
    fabricate.show_dense(report, WHOLE)
    page = report.read_text(encoding="utf-8")
    start = page.index('<section id="dense"')
    stop = page.index("</section>", start) + len("</section>\n")
    assert page[:start] + page[stop:] == before
    assert len(Page(page).ids()) == len(set(Page(page).ids()))
    assert Page(page).text.count("<!-- dense map -->") >= 1  # the name, as text


def test_a_second_map_takes_the_place_of_the_first(report: Path):
    fabricate.show_dense(report, WHOLE)
    first = report.read_bytes()
    fabricate.show_dense(report, WHOLE)
    assert report.read_bytes() == first
    assert len(images(report)) == 3


@pytest.mark.parametrize("content", [b"<p>not ours</p>", b"\xff\xfe\x00", b"<!-- dense map --> cut off"])
def test_a_page_without_a_place_is_left_as_it_is_and_named(tmp_path: Path, content: bytes):
    (tmp_path / "x.html").write_bytes(content)
    with pytest.raises(DataError, match=r"x\.html: expected a report with a place for the dense map"):
        fabricate.show_dense(tmp_path / "x.html", WHOLE)
    assert (tmp_path / "x.html").read_bytes() == content


def test_in_the_grid_ahead_is_up_and_left_is_left(report: Path):
    """Its own frame has x ahead and y to the left: the last column is farthest ahead, the first row leftmost."""
    cells = np.full((40, 60), UNKNOWN, np.uint8)
    cells[:10, 50:] = OCCUPIED  # ahead, to the left
    cells[30:, 50:] = FREE  # ahead, to the right
    fabricate.show_dense(report, WHOLE, Grid(cells, 0.5, np.array([-5.0, -8.0])))
    plan = images(report)[2]
    assert plan.shape[:2] == (60, 40)
    assert plan[3, 3].max() < 20
    assert plan[3, 36].min() > 230
    assert 180 < plan[50, 20].mean() < 230


def test_the_way_is_drawn_where_it_is_in_the_picture(report: Path):
    fabricate.show_dense(report, WHOLE)
    window = fabricate.dense_window(WHOLE)
    start = re.search(r'<polyline class="before" points="([\d.]+),([\d.]+)', report.read_text(encoding="utf-8"))
    assert start is not None
    left, below = map(float, start.groups())
    assert (window.left + left, window.top - below) == pytest.approx((0.0, 0.0), abs=0.06)


def test_height_is_hue_and_what_is_not_known_is_clear():
    view = fabricate.top_view(np.array([[np.nan, 0.0, 1.0, 2.0, 9.0]], np.float32))
    image = coloured(view, 0.0, 2.0)[0]
    assert image[:, 3].tolist() == [0, 255, 255, 255, 255]
    assert len(np.unique(image[1:4, :3], axis=0)) == 3
    assert (image[3] == image[4]).all()


@pytest.mark.parametrize(("most", "length"), [(1.0, 1.0), (33.0, 20.0), (99.9, 50.0), (100.0, 100.0), (0.07, 0.05)])
def test_a_scale_has_a_round_length(most: float, length: float):
    assert round_length(most) == pytest.approx(length)


def test_whatever_the_map_its_section_is_small(report: Path):
    """Of noise, which nothing compresses: a report of 22 MB stays below 25."""
    rng, size = np.random.default_rng(0), report.stat().st_size
    window, shape = Window(0.0, 0.0, 1.0, (1200, 1200)), (1200, 1200)
    grey = rng.integers(0, 256, shape, np.uint8)
    views = [TopView(rng.normal(size=shape).astype(np.float32), grey) for _ in range(2)]
    maps = [Overview(*both, WHOLE.odometry[:, :3, 3]) for both in zip(("before", "after"), views, strict=True)]
    grid = Grid(rng.choice(np.array([FREE, OCCUPIED, UNKNOWN], np.uint8), (3000, 3000)), 0.2, np.zeros(2))
    show_dense_map(report, maps, window, grid)
    assert report.stat().st_size - size < 3_000_000
