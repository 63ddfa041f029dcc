"""Style of all figures, pages and recordings: colours, fonts and axes, and figures as PNG and as SVG within a page.

The hues are those of Okabe and Ito (Color Universal Design, 2008), which colour-blind readers can tell apart. Lines
that could still be confused have different dashes as well.

Names of places and recordings may be in any script, so figures have fallback fonts. An SVG within a page has no outside
references, the colours of the theme, and real text.
"""

import io
import re
import warnings
from functools import cache
from pathlib import Path
from typing import IO, Any

import matplotlib
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont, fontManager, get_font
from matplotlib.text import Text

from slam.errors import OutputError

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
_NO_METADATA = dict.fromkeys(("Date", "Creator", "Format", "Type"))


def rgb(colour: str) -> tuple[int, int, int]:
    """Return red, green and blue, 0 to 255, of a colour `#rrggbb`."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def new_figure(width: float, height: float) -> Figure:
    """Make an empty figure, width and height in inches, that shares no state with others."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def style_axes(ax: Axes) -> None:
    """Give axes the common style of all figures."""
    ax.grid(True, linewidth=0.5, alpha=0.25, color=INK)
    ax.tick_params(colors=INK, labelsize=9)
    ax.xaxis.label.set_color(INK)
    ax.yaxis.label.set_color(INK)
    for side, spine in ax.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(INK)


def save_png(figure: Figure, path: Path) -> None:
    """Write a figure as PNG; the same figure gives the same bytes.

    Raises:
        OutputError: the file cannot be written.
    """
    try:
        path.write_bytes(render_png(figure))
    except OSError as error:
        raise OutputError(f"{path}: cannot write the picture ({error.strerror}); choose another folder") from error


def render_png(figure: Figure) -> bytes:
    """Render a figure as PNG on white, without the date and version that matplotlib would add."""
    buffer = io.BytesIO()
    save_figure(figure, buffer, format="png", dpi=130, facecolor="white", metadata={"Software": None})
    return buffer.getvalue()


def save_figure(figure: Figure, buffer: IO[Any], **options: Any) -> None:
    """Write a figure to a buffer as `Figure.savefig` does; a letter that no font has becomes a box."""
    set_font_fallbacks(figure)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph")
        figure.savefig(buffer, **options)


def set_font_fallbacks(figure: Figure) -> None:
    """Give every text of a figure the installed fallback families after its own font."""
    for text in figure.findobj(Text):
        own = text.get_fontfamily()
        text.set_fontfamily([*own, *(family for family in _installed() if family not in own)])


@cache
def _installed() -> tuple[str, ...]:
    known = set(fontManager.get_font_names())
    return tuple(family for family in FALLBACK_FAMILIES if family in known and _is_readable(family))


def _is_readable(family: str) -> bool:
    """Return whether a family's file can be opened; a damaged one would fail when the figure is drawn."""
    try:
        get_font(findfont(FontProperties(family=family), fallback_to_default=False))
    except (OSError, RuntimeError, ValueError):
        return False
    return True


def inline_svg(figure: Figure, name: str, title: str) -> Markup:
    """Render a figure as an `svg` element.

    Args:
        figure: figure to render.
        name: prefix that makes its ids unique within the page.
        title: description for readers who do not see the figure.
    """
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
