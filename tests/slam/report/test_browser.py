"""The report in a browser: what it shows, opens, sorts and loads, by mouse and by keyboard."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from selenium.webdriver.common.keys import Keys

from slam.report.formatting import MISSING, kept
from slam.report.html_report import write_report
from slam.report.loop_details import describe_stages
from slam.report.trajectory_figure import align_trajectory, position_errors

from . import fabricate
from .browser import NO_BROWSER, browser, has_browser

pytestmark = pytest.mark.skipif(not has_browser(), reason=NO_BROWSER)

NAME = "drive <b>\"'&amp; улица 街道"
_DRIVE = fabricate.with_evidence(fabricate.record())
_COVARIANCES = np.tile(np.eye(6), (len(_DRIVE.timestamps), 1, 1))
WHOLE = replace(_DRIVE, name=NAME, odometry_covariances=_COVARIANCES, corrected_covariances=_COVARIANCES)
WHOLE.metrics.update(source=NAME, places={"paradigm": NAME})
DARKEST, BRIGHTEST = 60, 180  # of 255
READABLE = 4.5  # contrast of text, WCAG 2.2, 1.4.3
CONTRAST = """
    const luminance = (colour) => {
        const parts = colour.match(/[\\d.]+/g).slice(0, 3).map((part) => {
            const value = part / 255;
            return value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4;
        });
        return 0.2126 * parts[0] + 0.7152 * parts[1] + 0.0722 * parts[2];
    };
    const behind = (node) => {
        const colour = getComputedStyle(node).backgroundColor;
        return colour.startsWith("rgba") ? behind(node.parentElement) : colour;
    };
    const words = "h1, p, dt, dd, caption, figcaption, .outcome, td, button:enabled";
    return [...document.querySelectorAll(words)].map((node) => {
        const both = [luminance(getComputedStyle(node).color), luminance(behind(node))].sort((a, b) => a - b);
        return (both[1] + 0.05) / (both[0] + 0.05);
    });
"""
POINT_AT_END = """
    const path = document.querySelectorAll(".inside")[arguments[0]].querySelector("g[id*=inside] > path[style*='1.8']");
    const end = path.getPointAtLength(path.getTotalLength()).matrixTransform(path.getScreenCTM());
    document.querySelectorAll(".pane svg:not(.inside)")[arguments[0]].dispatchEvent(
        new PointerEvent("pointermove", { clientX: end.x, clientY: end.y, bubbles: true }));
    return [end.x, end.y];
"""
WHEEL = """
    document.querySelectorAll(".pane")[arguments[2]].dispatchEvent(
        new WheelEvent("wheel", { clientX: arguments[0], clientY: arguments[1], deltaY: -400, bubbles: true }));
"""


DRAWN = """
    const slider = document.querySelector("#blend input");
    slider.value = arguments[0];
    slider.dispatchEvent(new Event("input"));
    const points = (line) => line.getAttribute("d").split(/[ML]/).slice(1).map((at) => at.split(" ").map(Number));
    return [".path", ".loops"].map((name) => points(document.querySelector(`#blend ${name}`)));
"""


@pytest.fixture(scope="module")
def driven():
    with browser() as shown:
        yield shown


@pytest.fixture(scope="module")
def path(tmp_path_factory) -> Path:
    file = tmp_path_factory.mktemp("report") / "a <b> 'report' улица.html"
    write_report(WHOLE, file, fabricate.street, {NAME: NAME}, "dense.html")
    return file


@pytest.fixture
def page(driven, path):
    """The page, newly opened; whatever a test does with it, nothing else is loaded and nothing goes wrong."""
    driven.theme("light")
    driven.screen(1280, 900)
    driven.open(path)
    yield driven
    assert driven.loaded() == [path.as_uri()]
    assert driven.complaints() == []


def test_a_page_that_loads_something_and_one_that_fails_would_be_noticed(driven, tmp_path):
    (tmp_path / "bad.html").write_text('<img src="nowhere.png"><script>nowhere()</script>')
    driven.open(tmp_path / "bad.html")
    assert (tmp_path / "nowhere.png").as_uri() in driven.loaded()
    assert any("nowhere is not defined" in words for words in driven.complaints())


def column(page, number: int) -> list[str]:
    """The cells of a column of the loop log, of the rows that are shown."""
    return page.run(
        "return [...document.querySelectorAll('#loop-log tbody tr:not([hidden])')]"
        ".map((row) => row.cells[arguments[0]].textContent)",
        number,
    )


def text(page, selector: str) -> str:
    return page.run("return document.querySelector(arguments[0]).textContent", selector)


def click(page, selector: str, number: int = 0) -> None:
    page.run("document.querySelectorAll(arguments[0])[arguments[1]].click()", selector, number)


def row_of(query: int):
    return next(row for row in WHOLE.loops if row.query == query)


def open_row(page, query: int) -> None:
    choose(page, "")
    click(page, "#loop-log .open", [row.query for row in WHOLE.loops].index(query))


def choose(page, outcome: str) -> None:
    page.run(
        "const outcome = document.querySelector('#outcome');"
        "outcome.value = arguments[0]; outcome.dispatchEvent(new Event('change'))",
        outcome,
    )


def test_a_heading_sorts_by_size_up_and_down_with_what_is_missing_last(page):
    click(page, "#loop-log th button", 6)
    assert page.run("return document.querySelectorAll('#loop-log th')[6].ariaSort") == "ascending"
    known = sum(np.isfinite(row.weight) for row in WHOLE.loops if row.accepted)
    assert MISSING not in column(page, 6)[:known]
    click(page, "#loop-log th button", 0)
    click(page, "#loop-log th button", 0)
    assert page.run("return document.querySelectorAll('#loop-log th')[0].ariaSort") == "descending"
    queries = [int(cell) for cell in column(page, 0)]
    assert queries == sorted((row.query for row in WHOLE.loops if row.accepted), reverse=True)


def test_the_loop_log_is_filtered_by_outcome_and_by_words(page):
    choose(page, "kept")
    kept = [row for row in WHOLE.loops if row.in_graph]
    assert column(page, 0) == [str(row.query) for row in kept]
    assert text(page, "#count") == f"{len(kept)} of {len(WHOLE.loops)} rows"
    choose(page, "")
    page.run("document.querySelector('#words').focus()")
    page.press("THRESHOLD")
    assert column(page, 0) == ["20"]


def test_a_row_opens_its_images_with_its_matches_and_each_stage(page):
    open_row(page, 110)
    row, (pair,) = row_of(110), [pair for pair in WHOLE.matched if pair.query == 110]
    sizes = page.driver.execute_async_script(
        "const done = arguments[0];"
        "Promise.all([...document.querySelectorAll('#pair image')].map(async (shown) => {"
        "  const image = new Image(); image.src = shown.href.baseVal; await image.decode();"
        "  return [image.naturalWidth, image.naturalHeight];"
        "})).then(done)"
    )
    assert sizes == [[620, 188]] * 2
    ends = page.run(
        "return [...document.querySelectorAll('#pair line')]"
        ".map((line) => ['x1', 'y1', 'x2', 'y2'].map((name) => line[name].baseVal.value))"
    )
    below = page.run("return document.querySelectorAll('#pair image')[1].y.baseVal.value")
    expected = np.concatenate([pair.pixels_query, pair.pixels_match + np.float32([0, below])], axis=1)
    assert len(ends) == row.inliers
    np.testing.assert_allclose(ends, expected, atol=0.51)
    stage = next(stage for stage in WHOLE.stages if stage.query == 110)
    events = [event for event in WHOLE.events if event.query == 110]
    assert text(page, "#pair-stages") == "".join(
        f"{name}{words}" for name, words in describe_stages(NAME, row, stage, events)
    )
    assert text(page, "#pair-title") == "Frame 110 with frame 10: closed."


def test_a_rejected_row_shows_what_geometry_found_and_an_unlikely_one_that_none_was_sought(page):
    open_row(page, 105)
    assert page.run("return document.querySelectorAll('#pair line').length") == row_of(105).inliers
    assert page.run("return getComputedStyle(document.querySelector('#pair line')).strokeDasharray") != "none"
    open_row(page, 20)
    assert page.run("return document.querySelectorAll('#pair image').length") == 2
    assert page.run("return document.querySelectorAll('#pair line').length") == 0
    assert "none agree with one geometry" in text(page, "#pair-caption")


def test_keys_alone_walk_the_rows_open_one_go_on_and_come_back(page):
    assert page.run("return document.querySelectorAll('#loop-log .open[tabindex=\"0\"]').length") == 1
    page.run("document.querySelector('#loop-log').closest('.scroll').focus()")
    page.press(*[Keys.TAB] * 11)  # past the headings
    page.press(Keys.ARROW_DOWN, Keys.ARROW_DOWN, Keys.ENTER)
    assert text(page, "#pair-title").startswith("Frame 115")
    page.press(Keys.ARROW_RIGHT)
    assert text(page, "#pair-title").startswith("Frame 120")
    page.press(Keys.ARROW_LEFT, Keys.ARROW_LEFT)
    assert text(page, "#pair-title").startswith("Frame 110")
    page.press(Keys.ESCAPE)
    assert page.run("return document.querySelector('#pair').open") is False
    assert page.run("return document.activeElement.textContent") == "110"


@pytest.mark.parametrize("number", [0, 1])
def test_the_frame_under_the_pointer_is_named_with_its_error_in_both_maps_at_any_zoom(page, number):
    errors = [position_errors(poses, WHOLE.ground_truth)[-1] for poses in (WHOLE.odometry, WHOLE.corrected)]
    page.run("document.querySelectorAll('.pane')[arguments[0]].focus()", number)
    for _ in range(3):
        page.run(POINT_AT_END, number)
        shown = page.run("return [...document.querySelectorAll('.map output')].map((said) => said.textContent)")
        assert [re.sub("x .*, ", "", words) for words in shown] == [f"Frame 199: error {end:.2f} m" for end in errors]
        page.run(WHEEL, *page.run(POINT_AT_END, number), number)


def aligned_plan(poses):
    aligned = align_trajectory(poses, WHOLE.ground_truth).apply(poses[:, :3, 3])
    return aligned[:, [0, 2]] * [1, -1]  # up on the page is -y


@pytest.mark.parametrize("step", [0, 50, 100, 200])
def test_the_slider_moves_trajectory_and_loops_evenly_from_before_to_after(page, step):
    before, after = aligned_plan(WHOLE.odometry), aligned_plan(WHOLE.corrected)
    expected = before + step / 200 * (after - before)
    path, loops = page.run(DRAWN, step)
    np.testing.assert_allclose(path, expected, atol=0.011)
    pairs = [frame for row in kept(WHOLE) for frame in (row.query, row.match)]
    np.testing.assert_allclose(loops, expected[pairs], atol=0.011)


def test_the_slider_names_both_ends_with_their_error_and_a_press_plays_it(page):
    for step, words in ((0, "Before: ATE 5.42 m"), (100, "Between the two"), (200, "After: ATE 0.83 m")):
        page.run(DRAWN, step)
        assert text(page, "#blend output") == words
    page.driver.execute_cdp_cmd(
        "Emulation.setEmulatedMedia", {"features": [{"name": "prefers-reduced-motion", "value": "reduce"}]}
    )
    for words in ("Before", "After"):
        click(page, "#blend button")
        assert text(page, "#blend output").startswith(words)


def test_ellipses_are_shown_on_request_only(page):
    shown = "return getComputedStyle(document.querySelector('[id$=\"-inside-ellipses\"]')).display"
    assert page.run(shown) == "none"
    click(page, "#ellipses")
    assert page.run(shown) == "inline"
    click(page, "#ellipses")


def test_a_finger_marks_a_frame(page):
    page.run(POINT_AT_END.replace("pointermove", "pointerdown"), 0)
    assert text(page, ".map output").startswith("Frame 199: ")


def test_maps_zoom_together_by_button_key_and_wheel_and_show_all_again(page):
    widths = "return [...document.querySelectorAll('.inside')].map((map) => map.viewBox.baseVal.width)"
    whole = page.run(widths)
    click(page, ".map .bar button", 0)
    np.testing.assert_allclose(page.run(widths), np.divide(whole, 1.5), rtol=1e-6)
    assert page.run("return document.querySelectorAll('.ticks text').length") > 8
    page.run("document.querySelector('.pane').focus()")
    page.press("+")
    np.testing.assert_allclose(page.run(widths), np.divide(whole, 1.5**2), rtol=1e-6)
    page.press("0")
    np.testing.assert_allclose(page.run(widths), whole)
    page.run(WHEEL, *page.run(POINT_AT_END, 0), 0)
    assert page.run(widths)[0] < 0.3 * whole[0]
    page.run("document.activeElement.blur()")
    before = page.run(widths)
    page.run(WHEEL, *page.run(POINT_AT_END, 0), 0)
    assert page.run(widths) == before  # the page is scrolled instead


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_the_page_of_the_dense_map_keeps_its_colours_and_loads_nothing(driven, tmp_path, theme):
    fabricate.write_dense(tmp_path / "dense.html", WHOLE)
    driven.theme(theme)
    driven.screen(1280, 900)
    driven.open(tmp_path / "dense.html")
    shown = driven.run(
        "return [...document.querySelectorAll('#dense image')].map((image) => "
        "[getComputedStyle(image).filter, image.getBoundingClientRect().width > 300])"
    )
    assert shown == [["none", True]] * 3
    assert min(driven.run(CONTRAST)) >= READABLE
    assert driven.loaded() == [(tmp_path / "dense.html").as_uri()]
    assert driven.complaints() == []


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_both_themes_can_be_read(page, theme):
    page.theme(theme)
    page_colour = page.run("return getComputedStyle(document.body).backgroundColor.match(/\\d+/g).map(Number)")
    assert max(page_colour) < DARKEST if theme == "dark" else min(page_colour) > BRIGHTEST
    assert min(page.run(CONTRAST)) >= READABLE
    click(page, "#theme")
    other = page.run("return getComputedStyle(document.body).backgroundColor.match(/\\d+/g).map(Number)")
    assert (max(other) < DARKEST) == (theme == "light")


def test_a_phone_shows_everything_without_scrolling_aside(page):
    page.screen(390, 844)
    assert page.run("return document.documentElement.scrollWidth") <= 390
    wider = page.run(
        "return [...document.querySelectorAll('main > section')]"
        ".map((part) => { part.scrollIntoView(); return part.scrollWidth - part.clientWidth; })"
    )
    assert wider == [0] * 7
    open_row(page, 110)
    left, right, inner, outer = page.run(
        "const box = document.querySelector('#pair'), { left, right } = box.getBoundingClientRect();"
        "return [left, right, box.scrollWidth, box.clientWidth]"
    )
    assert left >= 0
    assert right <= 390
    assert inner <= outer


def test_names_are_text_wherever_they_stand(page):
    assert text(page, "h1") == NAME
    assert page.driver.title == f"{NAME} {MISSING} Revisit"
    open_row(page, 110)
    assert text(page, "#pair-stages dd").startswith(NAME)
    assert page.run("return document.querySelectorAll('main b:not(.funnel b), dialog b').length") == 0
