"""The page of a dense map, `dense.html`: both maps from above, and the occupancy grid of the ground.

`revisit dense` fuses a map long after the report of a run was written, so the map has a page of its own, which the
report links to. No finished page is ever edited (docs/decisions/report_pages.md).
"""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from slam.io.files import atomic_writer
from slam.mapping.birds_eye_view import BirdsEyeView, PlaneWindow
from slam.mapping.occupancy_grid import OccupancyGrid
from slam.report.html_report import template_environment

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_MAX_SIDE_PX = 1200  # of a picture
_MAX_COLOR_SIDE_PX = 1000  # of one in colour, which compresses less
_WEBP_QUALITY = 80
_HEIGHT_PERCENTILES = (2.0, 98.0)  # ends of the colour scale, so that a few outliers do not stretch it
_FIRST_HUE = 50  # of 255: earlier colours are too dark for a dark page
_MIN_BRIGHTNESS = 0.7  # of a colour, for surfaces that are black in the images
_MAX_PATH_POINTS = 1000
_WORDS = {
    "before": ("Before: dense map by odometry", "Places that were visited twice do not fit where odometry drifted."),
    "after": ("After: dense map, loops closed", "The same surfaces, moved with the corrected trajectory."),
}


@dataclass(frozen=True)
class DenseOverview:
    """A dense map seen from above, with the path of the camera.

    Attributes:
        state: `before` or `after` correction.
        view: heights and colours of the map from above.
        positions: camera positions, (N, 3), metres.
    """

    state: str
    view: BirdsEyeView
    positions: Array


@dataclass(frozen=True)
class Drawing:
    """A picture of the ground plane with the path of the camera over it.

    Attributes:
        title, caption: heading and explanation.
        image: WebP in base64.
        width_m, height_m: size of the picture, metres.
        state: `before` or `after`, of the trajectory that is drawn.
        path: its points as SVG has them, metres from the upper left corner.
        scale_bar_m: length of the scale bar, metres.
    """

    title: str
    caption: str
    image: str
    width_m: float
    height_m: float
    state: str
    path: str
    scale_bar_m: float


def write_dense_page(path: Path, maps: Sequence[DenseOverview], window: PlaneWindow, grid: OccupancyGrid) -> None:
    """Write a page with pictures of both maps from above and of the occupancy grid.

    Args:
        path: the HTML file.
        maps: the maps before and after correction.
        window: part of the plane that their views show.
        grid: occupancy grid of the corrected map.

    Raises:
        OutputError: the file cannot be written.
    """
    page = template_environment().get_template("dense.html.jinja").render(drawings=_drawings(maps, window, grid))
    with atomic_writer(path) as file:
        file.write(page)


def _drawings(maps: Sequence[DenseOverview], window: PlaneWindow, grid: OccupancyGrid) -> list[Drawing]:
    heights = np.concatenate([one.view.height[np.isfinite(one.view.height)] for one in maps])
    low, high = np.percentile(heights, _HEIGHT_PERCENTILES) if len(heights) else (0.0, 1.0)
    is_grey = all(is_without_color(one.view.color) for one in maps)
    scale = f"Colour is height above the first camera, from {_metres(low)} (violet) to {_metres(high)} (yellow)."
    scale = scale if is_grey else "Colours are those of the images."
    drawings = []
    for one in maps:
        title, caption = _WORDS[one.state]
        image = colour_heights(one.view, low, high) if is_grey else paint_colors(one.view)
        drawings.append(_drawing(one, window, (title, f"{caption} {scale}"), image))
    return [*drawings, _floor_plan(maps[-1], grid)]


def _metres(length: float) -> str:
    return f"{length:.1f}\N{NO-BREAK SPACE}m".replace("-", "\N{MINUS SIGN}")


def _drawing(one: DenseOverview, window: PlaneWindow, words: tuple[str, str], image: Image) -> Drawing:
    height, width = (window.cell_m * side for side in window.shape)
    path = one.positions[:: len(one.positions) // _MAX_PATH_POINTS + 1, [0, 2]]
    x, y = path[:, 0] - window.left, window.top - path[:, 1]
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
    return Drawing(*words, _webp(image), width, height, one.state, points, round_length(max(width, height) / 5))


def _floor_plan(one: DenseOverview, grid: OccupancyGrid) -> Drawing:
    """Draw the grid with z up, as the other pictures are; in its own frame x points forward."""
    cells, (x, y), size = np.rot90(grid.cells), grid.origin.tolist(), grid.resolution_m
    rows, columns = cells.shape
    window = PlaneWindow(left=-y - size * columns, top=x + size * rows, cell_m=size, shape=(rows, columns))
    caption = "White: ground that was seen. Black: obstacles that stand on it. Grey: unknown."
    bgra = cv2.cvtColor(np.ascontiguousarray(cells), cv2.COLOR_GRAY2BGRA)
    return _drawing(one, window, ("Occupancy grid", caption), bgra)


def colour_heights(view: BirdsEyeView, low: float, high: float) -> Image:
    """Colour a view, (H, W, 4) uint8 BGRA: hue from height, brightness from the images, transparent where unknown."""
    known = np.isfinite(view.height)
    height = np.where(known, view.height, low)
    share = np.clip((height - low) / max(high - low, 1e-6), 0.0, 1.0)
    hue = cv2.applyColorMap((_FIRST_HUE + (255 - _FIRST_HUE) * share).astype(np.uint8), cv2.COLORMAP_VIRIDIS)
    bright = _MIN_BRIGHTNESS + (1.0 - _MIN_BRIGHTNESS) * view.color.mean(axis=2, keepdims=True) / 255.0
    return np.dstack([hue * bright, np.where(known, 255, 0)]).astype(np.uint8)


def is_without_color(color: Image) -> bool:
    """Whether an image (H, W, 3) is grey, so that its brightness is all it shows."""
    return bool((color[..., :1] == color).all())


def paint_colors(view: BirdsEyeView) -> Image:
    """Paint a view as it is in the images, (H, W, 4) uint8 BGRA, transparent where unknown."""
    image = np.dstack([view.color[..., ::-1], np.where(np.isfinite(view.height), 255, 0)]).astype(np.uint8)
    return _shrink(image, _MAX_COLOR_SIDE_PX)


def _webp(image: Image) -> str:
    _, data = cv2.imencode(".webp", _shrink(image, _MAX_SIDE_PX), [cv2.IMWRITE_WEBP_QUALITY, _WEBP_QUALITY])
    return base64.b64encode(data.tobytes()).decode()


def _shrink(image: Image, max_side_px: int) -> Image:
    ratio = min(1.0, max_side_px / max(image.shape[:2]))
    if ratio == 1.0:
        return image
    return np.asarray(cv2.resize(image, None, fx=ratio, fy=ratio, interpolation=cv2.INTER_AREA), np.uint8)


def round_length(max_length: float) -> float:
    """Return the largest number of the form 1, 2 or 5 times a power of ten that is not above `max_length`."""
    power = 10.0 ** np.floor(np.log10(max_length))
    return float(max(step * power for step in (1, 2, 5) if step * power <= max_length))
