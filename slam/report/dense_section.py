"""The dense map within the report of its run: drawn later than the rest of the page, and put into its place there."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from slam.errors import DataError
from slam.mapping.occupancy import Grid
from slam.mapping.top_view import TopView, Window
from slam.report.page import environment
from slam.storage.atomic import atomic_writer

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

# Nothing else in a page can hold these words: what is not ours is escaped there.
_BEGIN, _END = "<!-- dense map -->", "<!-- end of dense map -->"
_LONGER_SIDE = 1200  # pixels at most
_QUALITY = 80
_HEIGHTS = (2.0, 98.0)  # percentiles between which heights have colours
_FIRST_HUE = 50  # of 255: those before it are too dark to be seen on a dark page
_DARKEST = 0.7  # of a colour, for what was black in the images
_WAY_POINTS = 1000


@dataclass(frozen=True)
class Overview:
    """A dense map and what it was made on.

    Attributes:
        state: before or after correction.
        view: from above.
        positions: (N, 3) metres, of the cameras.
    """

    state: str
    view: TopView
    positions: Array


@dataclass(frozen=True)
class Drawing:
    """A picture of the plane, with the way over it.

    Attributes:
        title, caption: what it shows, and how to read it.
        image: WebP in base64.
        width, height: metres.
        state: of the map whose way it is.
        way: x and y in metres from the upper left corner, as SVG has them.
        bar: length of the scale, metres.
    """

    title: str
    caption: str
    image: str
    width: float
    height: float
    state: str
    way: str
    bar: float


def show_dense_map(report: Path, maps: Sequence[Overview], window: Window, grid: Grid) -> None:
    """Put pictures of both maps, seen from above, and of the grid into the page of their run; earlier ones go.

    Raises:
        DataError: the file is no report, or an older one that has no place for them.
        OutputError: it cannot be written.
    """
    try:
        page = report.read_text(encoding="utf-8")
        before, _, rest = page.partition(_BEGIN)
        _, end, after = rest.partition(_END)
    except (OSError, UnicodeDecodeError):
        end = ""
    if not end:
        raise DataError(f"{report}: expected a report with a place for the dense map, found none; make the run again")
    section = environment().get_template("dense.html.jinja").render(drawings=_drawings(maps, window, grid))
    with atomic_writer(report) as file:
        file.write(f"{before}{_BEGIN}\n{section}\n{_END}{after}")


def _drawings(maps: Sequence[Overview], window: Window, grid: Grid) -> list[Drawing]:
    heights = np.concatenate([one.view.height[np.isfinite(one.view.height)] for one in maps])
    low, high = np.percentile(heights, _HEIGHTS) if len(heights) else (0.0, 1.0)
    scale = f"Colour is height above the first camera, from {_metres(low)} (violet) to {_metres(high)} (yellow)."
    told = {
        "before": ("Before: dense map by odometry", "Where the way is driven again, what is seen twice need not fit."),
        "after": ("After: dense map, loops closed", "The same surfaces, moved with the corrected trajectory."),
    }
    drawn = [
        _drawing(one, window, (title, f"{caption} {scale}"), coloured(one.view, low, high))
        for one in maps
        for title, caption in [told[one.state]]
    ]
    return [*drawn, _floor_plan(maps[-1], grid)]


def _metres(length: float) -> str:
    return f"{length:.1f}\N{NO-BREAK SPACE}m".replace("-", "\N{MINUS SIGN}")


def _drawing(one: Overview, window: Window, words: tuple[str, str], image: Image) -> Drawing:
    height, width = (window.cell_m * side for side in window.shape)
    way = one.positions[:: len(one.positions) // _WAY_POINTS + 1, [0, 2]]
    x, y = way[:, 0] - window.left, window.top - way[:, 1]
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
    return Drawing(*words, _webp(image), width, height, one.state, points, round_length(max(width, height) / 5))


def _floor_plan(one: Overview, grid: Grid) -> Drawing:
    """The grid, turned so that z is up as in the other pictures: in its own frame x is forward."""
    cells, (x, y), size = np.rot90(grid.cells), grid.origin.tolist(), grid.resolution_m
    rows, columns = cells.shape
    window = Window(left=-y - size * columns, top=x + size * rows, cell_m=size, shape=(rows, columns))
    caption = "White was seen to be road or pavement, black stands in the way, of grey nothing is known."
    bgra = cv2.cvtColor(np.ascontiguousarray(cells), cv2.COLOR_GRAY2BGRA)
    return _drawing(one, window, ("What can be driven on", caption), bgra)


def coloured(view: TopView, low: float, high: float) -> Image:
    """Draw a view as (H, W, 4) uint8, blue first: hue from its height, brightness from the images, nothing clear."""
    known = np.isfinite(view.height)
    height = np.where(known, view.height, low)
    share = np.clip((height - low) / max(high - low, 1e-6), 0.0, 1.0)
    hue = cv2.applyColorMap((_FIRST_HUE + (255 - _FIRST_HUE) * share).astype(np.uint8), cv2.COLORMAP_VIRIDIS)
    bright = _DARKEST + (1.0 - _DARKEST) * view.grey[..., None] / 255.0
    return np.dstack([hue * bright, np.where(known, 255, 0)]).astype(np.uint8)


def _webp(image: Image) -> str:
    shrink = min(1.0, _LONGER_SIDE / max(image.shape[:2]))
    small = image if shrink == 1.0 else cv2.resize(image, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
    _, data = cv2.imencode(".webp", small, [cv2.IMWRITE_WEBP_QUALITY, _QUALITY])
    return base64.b64encode(data.tobytes()).decode()


def round_length(most: float) -> float:
    """The longest of 1, 2, 5, 10, ... metres, or of their tenths and so on, that is not above `most`."""
    power = 10.0 ** np.floor(np.log10(most))
    return float(max(step * power for step in (1, 2, 5) if step * power <= most))
