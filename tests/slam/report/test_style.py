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
from slam.report.style import MAX_POINTS, new_figure, save_png, simplify_line, thin_curve, thin_dots

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


def spiral(points: int) -> np.ndarray:
    angle = np.linspace(0.0, 40 * np.pi, points)
    return np.stack([angle * np.cos(angle), angle * np.sin(angle)], axis=1)


def distance_to_line(points: np.ndarray, line: np.ndarray) -> float:
    """Largest distance of any of the points from a polyline."""
    begin, along = line[:-1], np.diff(line, axis=0)
    far = []
    for point in points:
        share = np.clip(((point - begin) * along).sum(axis=1) / (along**2).sum(axis=1), 0.0, 1.0)
        far.append(np.linalg.norm(begin + share[:, None] * along - point, axis=1).min())
    return max(far)


def test_a_short_line_keeps_every_point():
    for points in (spiral(0), spiral(1), spiral(MAX_POINTS)):
        np.testing.assert_array_equal(simplify_line(points), np.arange(len(points)))


def test_a_long_line_is_thinned_by_less_than_a_pixel():
    points = spiral(40_000)
    rows = simplify_line(points)
    assert rows[0] == 0
    assert rows[-1] == len(points) - 1
    assert len(rows) <= MAX_POINTS
    pixel = np.ptp(points, axis=0).max() / 400  # of a figure in the page
    assert distance_to_line(points[::37], points[rows]) < 0.2 * pixel
    assert (
        distance_to_line(points[::37], points[:: len(points) // len(rows) * 8]) > 0.2 * pixel
    )  # the test would see it


def test_a_line_of_noise_is_cut_down_too():
    assert len(simplify_line(np.random.default_rng(0).normal(size=(30_000, 2)))) <= MAX_POINTS


def test_a_standing_camera_is_a_line_of_two_points():
    assert len(simplify_line(np.zeros((6000, 4)))) == 2


def test_dots_that_hide_one_another_are_drawn_once():
    places = np.random.default_rng(0).uniform(0.0, 100.0, (300, 2))
    points = np.tile(places, (60, 1))
    shown = points[thin_dots(points)]
    assert len(shown) <= 300
    assert max(np.linalg.norm(shown - place, axis=1).min() for place in places) < 0.5
    assert len(thin_dots(np.random.default_rng(0).uniform(size=(60_000, 2)))) <= MAX_POINTS
    np.testing.assert_array_equal(thin_dots(places), np.arange(300))


def test_a_thinned_curve_keeps_its_peaks_and_its_ends():
    values = np.random.default_rng(0).normal(size=50_000)
    values[[17, 30_011]] = 40.0, -40.0
    rows = thin_curve(values)
    assert {0, 17, 30_011, len(values) - 1} <= set(rows.tolist())
    assert len(rows) < 2100
    np.testing.assert_array_equal(thin_curve(values[:900]), np.arange(900))
