"""Fallback fonts of figures: names of places and recordings may be in any script."""

from functools import cache

from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont, fontManager, get_font
from matplotlib.text import Text

# Families of wide coverage on Linux, macOS and Windows, tried in this order for letters that DejaVu Sans, matplotlib's
# own font, lacks. Only installed ones are used: matplotlib warns of any other.
FALLBACK_FAMILIES = (
    "Noto Sans", "Noto Sans CJK SC", "Noto Sans CJK JP", "Noto Sans CJK KR", "Noto Sans SC", "Noto Sans JP",
    "Noto Sans KR", "Source Han Sans SC", "WenQuanYi Zen Hei", "Droid Sans Fallback", "Noto Sans Devanagari",
    "Noto Sans Bengali", "Noto Sans Tamil", "Noto Sans Thai", "Noto Sans Hebrew", "Noto Sans Arabic", "FreeSans",
    "Unifont", "Arial Unicode MS", "PingFang SC", "Hiragino Sans", "Apple SD Gothic Neo", "Microsoft YaHei",
    "Yu Gothic", "Malgun Gothic", "Nirmala UI", "Leelawadee UI", "Segoe UI",
)  # fmt: skip


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


GROUND_TRUTH = "#808080"  # drawn dashed
ODOMETRY = "#e69f00"
ONLINE = "#cc79a7"
CORRECTED = "#0072b2"
ACCEPTED = "#009e73"
REJECTED = "#d55e00"  # drawn dotted
SCALE_END = "#001d33"  # of the largest values in pictures of matrices


def rgb(colour: str) -> tuple[int, int, int]:
    """Return red, green and blue, 0 to 255, of a colour `#rrggbb`."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
