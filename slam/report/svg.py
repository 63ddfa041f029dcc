"""Figures as SVG inside a page: no outside reference, colours of the theme, text that can be read."""

import io
import re

import matplotlib
from markupsafe import Markup
from matplotlib.figure import Figure

from slam.report import colours
from slam.report.figures import INK, render

# The style sheet gives these variables one value for light pages and one for dark.
_THEMED = {
    INK: "currentColor",
    colours.GROUND_TRUTH: "var(--truth)",
    colours.ODOMETRY: "var(--odometry)",
    colours.ONLINE: "var(--online)",
    colours.CORRECTED: "var(--corrected)",
    colours.ACCEPTED: "var(--accepted)",
    colours.REJECTED: "var(--rejected)",
    colours.MOST: "var(--most)",
}
_NOTHING = dict.fromkeys(("Date", "Creator", "Format", "Type"))


def inline_svg(figure: Figure, name: str, title: str) -> Markup:
    """Render a figure as an `svg` element.

    Args:
        figure: to render.
        name: letters that make its ids unique within the page.
        title: what it shows, for those who do not see it.
    """
    buffer = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": name}):
        render(figure, buffer, format="svg", dpi=120, transparent=True, metadata=_NOTHING)
    drawn = buffer.getvalue()
    drawn = drawn[drawn.index("<svg") :]
    drawn = re.sub(r"<metadata>.*?</metadata>", "", drawn, flags=re.DOTALL)
    drawn = re.sub(r' xmlns(:\w+)?="[^"]*"', "", drawn)
    drawn = re.sub(r' (width|height)="[\d.]+pt"', "", drawn, count=2)
    drawn = re.sub(r'( id="|href="#|url\(#)', rf"\g<1>{name}-", drawn)
    for colour, themed in _THEMED.items():
        drawn = drawn.replace(colour, themed)
    label = Markup(' role="img" aria-label="{}"').format(title)
    return Markup(drawn.replace("<svg", f"<svg{label}", 1))  # our own drawing; matplotlib escapes its text
