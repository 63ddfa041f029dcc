"""Style of all figures, pages and recordings: colours, fonts and axes, and figures as PNG and as SVG within a page.

The hues are those of Okabe and Ito (Color Universal Design, 2008), which colour-blind readers can tell apart. Lines
that could still be confused have different dashes as well.

Names of places and recordings may be in any script, so figures have fallback fonts. An SVG within a page has no outside
references, the colours of the theme, and real text.

A drive of a day has more points than a screen can show: lines are simplified to less than a pixel, and dots that would
hide one another are drawn once.
"""

import io
import re
import warnings
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup
from numba import njit
from numpy.typing import NDArray

from slam.errors import OutputError

if TYPE_CHECKING:  # imported where it is used: a recording needs the colours, and no figure before the drive ends
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

# Trajectories and loops have the same colours everywhere.
GROUND_TRUTH = "#808080"  # drawn dashed
ODOMETRY = "#e69f00"
ONLINE = "#cc79a7"
CORRECTED = "#0072b2"
ACCEPTED = "#009e73"
REJECTED = "#d55e00"  # drawn dotted
SCALE_END = "#001d33"  # of the largest values in pictures of matrices
INK = "#1a1a1a"  # of axes and text

# Families of wide coverage on Linux, macOS and Windows, tried in this order for letters that DejaVu Sans, matplotlib's
# own font, lacks. Only installed ones are used: matplotlib warns of any other.
FALLBACK_FAMILIES = (
    "Noto Sans", "Noto Sans CJK SC", "Noto Sans CJK JP", "Noto Sans CJK KR", "Noto Sans SC", "Noto Sans JP",
    "Noto Sans KR", "Source Han Sans SC", "WenQuanYi Zen Hei", "Droid Sans Fallback", "Noto Sans Devanagari",
    "Noto Sans Bengali", "Noto Sans Tamil", "Noto Sans Thai", "Noto Sans Hebrew", "Noto Sans Arabic", "FreeSans",
    "Unifont", "Arial Unicode MS", "PingFang SC", "Hiragino Sans", "Apple SD Gothic Neo", "Microsoft YaHei",
    "Yu Gothic", "Malgun Gothic", "Nirmala UI", "Leelawadee UI", "Segoe UI",
)  # fmt: skip

# The style sheet gives each of these variables a value for light pages and one for dark pages.
_THEMED = {
    INK: "currentColor",
    GROUND_TRUTH: "var(--truth)",
    ODOMETRY: "var(--odometry)",
    ONLINE: "var(--online)",
    CORRECTED: "var(--corrected)",
    ACCEPTED: "var(--accepted)",
    REJECTED: "var(--rejected)",
    SCALE_END: "var(--most)",
}
# What a page shows of a long drive. Shorter ones are drawn point by point.
MAX_POINTS = 5000  # of a line
_LINE_SHARE = 4e-4  # of the extent of a line by which it may be off: a fifth of a pixel in a page
_DOTS_ACROSS = 400  # that can be told apart
_COLUMNS = 1000  # of a chart
_NO_METADATA = dict.fromkeys(("Date", "Creator", "Format", "Type"))


def rgb(colour: str) -> tuple[int, int, int]:
    """Return red, green and blue, 0 to 255, of a colour `#rrggbb`."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def new_figure(width: float, height: float) -> "Figure":
    """Make an empty figure, width and height in inches, that shares no state with others."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def style_axes(ax: "Axes") -> None:
    """Give axes the common style of all figures."""
    ax.grid(True, linewidth=0.5, alpha=0.25, color=INK)
    ax.tick_params(colors=INK, labelsize=9)
    ax.xaxis.label.set_color(INK)
    ax.yaxis.label.set_color(INK)
    for side, spine in ax.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(INK)


def save_png(figure: "Figure", path: Path) -> None:
    """Write a figure as PNG; the same figure gives the same bytes.

    Raises:
        OutputError: the file cannot be written.
    """
    try:
        path.write_bytes(render_png(figure))
    except OSError as error:
        raise OutputError(f"{path}: cannot write the picture ({error.strerror}); choose another folder") from error


def render_png(figure: "Figure") -> bytes:
    """Render a figure as PNG on white, without the date and version that matplotlib would add."""
    buffer = io.BytesIO()
    save_figure(figure, buffer, format="png", dpi=130, facecolor="white", metadata={"Software": None})
    return buffer.getvalue()


def save_figure(figure: "Figure", buffer: IO[Any], **options: Any) -> None:
    """Write a figure to a buffer as `Figure.savefig` does; a letter that no font has becomes a box."""
    set_font_fallbacks(figure)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph")
        figure.savefig(buffer, **options)


def set_font_fallbacks(figure: "Figure") -> None:
    """Give every text of a figure the installed fallback families after its own font."""
    from matplotlib.text import Text

    for text in figure.findobj(Text):
        own = text.get_fontfamily()
        text.set_fontfamily([*own, *(family for family in _installed() if family not in own)])


@cache
def _installed() -> tuple[str, ...]:
    from matplotlib.font_manager import fontManager

    known = set(fontManager.get_font_names())
    return tuple(family for family in FALLBACK_FAMILIES if family in known and _is_readable(family))


def _is_readable(family: str) -> bool:
    """Return whether a family's file can be opened; a damaged one would fail when the figure is drawn."""
    from matplotlib.font_manager import FontProperties, findfont, get_font

    try:
        get_font(findfont(FontProperties(family=family), fallback_to_default=False))
    except (OSError, RuntimeError, ValueError):
        return False
    return True


def inline_svg(figure: "Figure", name: str, title: str) -> Markup:
    """Render a figure as an `svg` element.

    Args:
        figure: figure to render.
        name: prefix that makes its ids unique within the page.
        title: description for readers who do not see the figure.
    """
    import matplotlib

    buffer = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": name}):
        save_figure(figure, buffer, format="svg", dpi=120, transparent=True, metadata=_NO_METADATA)
    drawn = buffer.getvalue()
    drawn = drawn[drawn.index("<svg") :]
    drawn = re.sub(r"<metadata>.*?</metadata>", "", drawn, flags=re.DOTALL)
    drawn = re.sub(r' xmlns(:\w+)?="[^"]*"', "", drawn)
    drawn = re.sub(r' (width|height)="[\d.]+pt"', "", drawn, count=2)
    drawn = re.sub(r'( id="|href="#|url\(#)', rf"\g<1>{name}-", drawn)
    for colour, themed in _THEMED.items():
        drawn = drawn.replace(colour, themed)
    label = Markup(' role="img" aria-label="{}"').format(title)
    return Markup(drawn.replace("<svg", f"<svg{label}", 1))  # safe to mark: matplotlib escapes the text


def simplify_line(points: Array) -> Rows:
    """Choose the points of a line that a screen can show, by Douglas and Peucker (Cartographica 10(2), 1973).

    Args:
        points: (N, d); finite, of which more than MAX_POINTS are thinned.

    Returns:
        (K,) rows of the points, increasing, with the first and the last one. The line through them is nowhere further
        from the others than a fifth of a pixel, or a few where MAX_POINTS would not suffice.
    """
    if len(points) <= MAX_POINTS:
        return np.arange(len(points))
    tolerance = _LINE_SHARE * float(np.ptp(points, axis=0).max())
    while True:
        rows = _simplify(np.ascontiguousarray(points, np.float64), tolerance)
        if len(rows) <= MAX_POINTS:
            return rows
        tolerance *= 1.5


@njit(cache=True, nogil=True)
def _simplify(points: Array, tolerance: float) -> Rows:
    """Rows of the points (N, d) from whose line no other one is further away than the tolerance."""
    is_kept = np.zeros(len(points), np.bool_)
    waiting = [(0, len(points) - 1)]
    while len(waiting) > 0:
        first, last = waiting.pop()
        is_kept[first] = is_kept[last] = True
        along = points[last] - points[first]
        length = max(np.sum(along * along), 1e-12)
        middle, farthest = first, 0.0
        for k in range(first + 1, last):
            share, squared = 0.0, 0.0
            for i in range(points.shape[1]):
                share += (points[k, i] - points[first, i]) * along[i]
            share = min(max(share / length, 0.0), 1.0)
            for i in range(points.shape[1]):
                squared += (points[k, i] - points[first, i] - share * along[i]) ** 2
            if squared > farthest:
                middle, farthest = k, squared
        if farthest > tolerance**2:
            waiting.append((first, middle))
            waiting.append((middle, last))
    return np.flatnonzero(is_kept)


def thin_dots(points: Array) -> Rows:
    """Choose the rows of points (N, d) of which more than MAX_POINTS would hide one another: one of each place."""
    if len(points) <= MAX_POINTS:
        return np.arange(len(points))
    from_corner = (points - points.min(axis=0)) / max(float(np.ptp(points, axis=0).max()), 1e-12)
    across = float(_DOTS_ACROSS)
    while True:
        rows = np.unique(np.floor(across * from_corner), axis=0, return_index=True)[1]
        if len(rows) <= MAX_POINTS:
            return np.sort(rows)
        across /= 1.5


def thin_curve(values: Array) -> Rows:
    """Choose the rows of values (N,) over their index that a chart can show: the extremes of each of its columns."""
    if len(values) <= MAX_POINTS:
        return np.arange(len(values))
    bounds = np.linspace(0, len(values), _COLUMNS + 1).astype(np.int64)
    parts = [(begin, values[begin:end]) for begin, end in pairwise(bounds.tolist())]
    extremes = [begin + k for begin, part in parts for k in (int(part.argmin()), int(part.argmax()))]
    return np.unique([0, *extremes, len(values) - 1])
