"""Letters of every script in pictures: what the usual font lacks is taken from any installed one that has it."""

from functools import lru_cache

from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont, fontManager, get_font
from matplotlib.text import Text

_BOXES = "Last Resort"  # a font that has everything, as empty boxes


def choose_fonts(figure: Figure) -> None:
    """Give the words of a figure the fonts that their letters need; where no font has one it stays a box."""
    texts = figure.findobj(Text)
    letters = frozenset(ord(letter) for text in texts for letter in text.get_text() if letter.isprintable())
    more = _fonts_with(letters - _letters(findfont(FontProperties())))
    for text in texts:
        known = text.get_fontfamily()
        text.set_fontfamily([*known, *(name for name in more if name not in known)])


@lru_cache(maxsize=8)
def _fonts_with(letters: frozenset[int]) -> tuple[str, ...]:
    """As few fonts as have these letters, first come by name; what none has is left out."""
    chosen, missing = [], set(letters)
    for entry in sorted(fontManager.ttflist, key=lambda entry: (entry.name, entry.fname)):
        if not missing:
            break
        if entry.style == "normal" and not entry.name.startswith(_BOXES):
            has = missing & _letters(entry.fname)
            chosen += [entry.name] if has else []
            missing -= has
    return tuple(chosen)


def _letters(path: str) -> set[int]:
    """Code points that a font can draw at any size; none where the file is damaged or gone."""
    try:
        font = get_font(path)
    except (OSError, RuntimeError):
        return set()
    return set(font.get_charmap()) if font.scalable else set()
