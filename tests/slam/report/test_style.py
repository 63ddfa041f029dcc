"""Names in any script: drawn where an installed font has the letters, and never an error where none has."""

import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from fontTools.fontBuilder import FontBuilder
from fontTools.pens.ttGlyphPen import TTGlyphPen
from matplotlib import font_manager
from matplotlib import image as images

from place_recognition.evaluation.precision_recall import precision_recall
from slam.report import style
from slam.report.place_recognition_figures import plot_precision_recall
from slam.report.style import new_figure, save_png

STREET = "街"
FAMILY = "Noto Sans CJK SC"  # one of the fallback families


def block(side: int):
    pen = TTGlyphPen(None)
    pen.moveTo((0, 0)), pen.lineTo((0, side)), pen.lineTo((side, side)), pen.lineTo((side, 0)), pen.closePath()
    return pen.glyph()


@pytest.fixture
def font(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Install a font of a fallback family whose only letter is a black block."""
    builder = FontBuilder(1000, isTTF=True)
    builder.setupGlyphOrder([".notdef", "street"])
    builder.setupCharacterMap({ord(STREET): "street"})
    builder.setupGlyf({".notdef": block(10), "street": block(900)})
    builder.setupHorizontalMetrics({".notdef": (1000, 0), "street": (1000, 0)})
    builder.setupHorizontalHeader(ascent=900, descent=-100)
    builder.setupNameTable({"familyName": FAMILY, "styleName": "Regular"})
    builder.setupOS2(), builder.setupPost()
    builder.save(tmp_path / "block.ttf")
    others = [entry for entry in font_manager.fontManager.ttflist if entry.name not in style.FALLBACK_FAMILIES]
    monkeypatch.setattr(font_manager.fontManager, "ttflist", others)
    font_manager.fontManager.addfont(tmp_path / "block.ttf")
    style._installed.cache_clear()
    yield FAMILY
    style._installed.cache_clear()


def drawn(title: str, path: Path) -> np.ndarray:
    figure = new_figure(2.0, 1.0)
    figure.suptitle(title, parse_math=False)
    save_png(figure, path)
    return images.imread(path)[..., 0]


def test_a_letter_that_another_font_has_is_taken_from_there(font: str, tmp_path: Path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ink = drawn(f"a {STREET}", tmp_path / "x.png") < 0.5
    assert ink.sum() > 330  # the block, 0.9 of 12 points square at 130 dots an inch: no box of lines has so much


def test_a_letter_that_no_font_has_is_a_box_and_no_warning(tmp_path: Path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert (drawn("\U0001f30d \ue000 a", tmp_path / "x.png") < 0.9).any()


def test_usual_letters_are_drawn_as_without_other_fonts(tmp_path: Path, request: pytest.FixtureRequest):
    style._installed.cache_clear()
    before = drawn("Straße, улица, ὁδός", tmp_path / "before.png")
    request.getfixturevalue("font")
    np.testing.assert_array_equal(drawn("Straße, улица, ὁδός", tmp_path / "after.png"), before)


def test_only_installed_families_are_asked_for(font: str):
    figure = new_figure(1.0, 1.0)
    text = figure.suptitle("a")
    own = text.get_fontfamily()
    style.set_font_fallbacks(figure)
    assert text.get_fontfamily() == [*own, font]


def test_a_font_file_that_is_damaged_is_passed_over(font: str, tmp_path: Path):
    (tmp_path / "block.ttf").write_bytes(b"no font")
    font_manager._get_font.cache_clear()
    assert (drawn(STREET, tmp_path / "x.png") < 0.9).any()


def test_names_of_curves_are_no_formulas(tmp_path: Path):
    curve = precision_recall([], np.eye(3, dtype=bool))
    save_png(plot_precision_recall({r"$\frac{a": curve}, r"$\frac{b"), tmp_path / "x.png")
    assert images.imread(tmp_path / "x.png").std() > 0.01
