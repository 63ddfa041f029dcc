"""Figures as SVG within a page: without outside references, in the colours of the theme, with real text."""

import io
import re

import matplotlib
from markupsafe import Markup
from matplotlib.figure import Figure

from slam.report import colours
from slam.report.trajectory_figure import INK, save_figure

# The style sheet gives each of these variables a value for light pages and one for dark pages.
_THEMED = {
    INK: "currentColor",
    colours.GROUND_TRUTH: "var(--truth)",
    colours.ODOMETRY: "var(--odometry)",
    colours.ONLINE: "var(--online)",
    colours.CORRECTED: "var(--corrected)",
    colours.ACCEPTED: "var(--accepted)",
    colours.REJECTED: "var(--rejected)",
    colours.SCALE_END: "var(--most)",
}
_NO_METADATA = dict.fromkeys(("Date", "Creator", "Format", "Type"))


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
