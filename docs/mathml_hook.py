"""Formulas of the pages as MathML, which browsers draw themselves: the site needs no script and no other host."""

import html
import re
from typing import Any

from latex2mathml.converter import convert

# What pymdownx.arithmatex leaves of $...$ and $$...$$.
FORMULA = re.compile(r'<(span|div) class="arithmatex">(?:\\\((.*?)\\\)|\\\[(.*?)\\\])</\1>', re.DOTALL)


def on_page_content(content: str, **_: Any) -> str:
    """Replace the formulas of a page, after Markdown has become HTML."""
    return FORMULA.sub(to_mathml, content)


def to_mathml(found: re.Match[str]) -> str:
    """Render one formula, inline or as a block."""
    inline, block = found.group(2), found.group(3)
    return convert(html.unescape(inline or block), display="inline" if inline else "block")
