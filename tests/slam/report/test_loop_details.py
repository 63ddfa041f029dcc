import base64
import re
from dataclasses import replace

import cv2
import numpy as np
import pytest

from slam.report.interactive_map import draw_interactive_map, map_data
from slam.report.loop_details import describe_outcome, describe_stages, loop_details, make_album, select_rows
from slam.report.style import inline_svg
from slam.run_result import LoopRow

from . import fabricate

WHOLE = fabricate.with_evidence(fabricate.record())
BY_FRAMES = {(row.query, row.match): row for row in WHOLE.loops}
FLAT = np.full(fabricate.IMAGE, 90, np.uint8)


def rows(count):
    return [LoopRow(query, query - 500, 1.0, query % 3 > 0) for query in range(500, 500 + count)]


def decoded(picture):
    return cv2.imdecode(np.frombuffer(base64.b64decode(picture), np.uint8), cv2.IMREAD_GRAYSCALE)


def test_each_image_is_stored_once_however_many_rows_show_it():
    found = loop_details(WHOLE, fabricate.street)
    assert set(found["pictures"]) == {frame for pair in BY_FRAMES for frame in pair}
    assert len(set(found["pictures"].values())) == len(found["pictures"])


def test_a_picture_is_its_frame_small():
    known = fabricate.street(110)
    small = decoded(loop_details(WHOLE, fabricate.street)["pictures"][110]).astype(float)
    expected = cv2.resize(known, small.shape[::-1], interpolation=cv2.INTER_AREA)
    assert small.shape == (188, 620)
    assert np.abs(small - expected).mean() < 6


def test_every_row_has_its_matches_to_the_pixel_and_its_story():
    stages = {(stage.query, stage.match): stage for stage in WHOLE.stages}
    matched = {(pair.query, pair.match): pair for pair in WHOLE.matched}
    for found in loop_details(WHOLE, fabricate.street)["rows"]:
        key = found["query"], found["match"]
        row = BY_FRAMES[key]
        assert found["title"] == describe_outcome(row)
        events = [event for event in WHOLE.events if (event.query, event.match) == key]
        assert found["stages"] == list(describe_stages("\N{EN DASH}", row, stages[key], events))
        lines = np.reshape(found["lines"], (-1, 4))
        assert len(lines) == row.inliers
        if key in matched:
            exact = np.concatenate([matched[key].pixels_query, matched[key].pixels_match], axis=1)
            np.testing.assert_allclose(lines, exact, atol=0.5)


def test_of_many_matches_some_are_drawn_and_the_caption_says_so():
    row = next(row for row in WHOLE.loops if row.in_graph)
    many = replace(row, inliers=450)
    pair = fabricate.matched(many, np.random.default_rng(0))
    (found,) = loop_details(replace(WHOLE, loops=(many,), matched=(pair,)), fabricate.street)["rows"]
    assert len(found["lines"]) == 4 * 100
    assert "Drawn: 100 of the 450 matches" in found["caption"]


@pytest.mark.parametrize("budget", [30_000, 200_000])
def test_images_keep_to_their_budget_revisits_first_and_spread_over_the_drive(budget):
    many = rows(240)
    found = make_album(many, fabricate.street, budget)
    assert budget / 2 < sum(map(len, found.pictures.values())) <= budget
    shown = [row for row in many if found.shows(row)]
    assert all(row.accepted for row in shown)
    queries = [row.query for row in shown]
    assert np.diff([500, *queries, 740]).max() < 4 * 240 / len(shown)


def test_few_images_are_larger_than_many():
    few, many = (decoded(make_album(rows(count), fabricate.street, 400_000).pictures[501]).shape for count in (10, 40))
    assert few[1] == 620
    assert 320 <= many[1] < 620


def test_small_images_are_not_enlarged():
    found = make_album(rows(5), lambda _: FLAT[:100, :200])
    assert decoded(found.pictures[500]).shape == (100, 200)
    assert (found.width, found.height) == (200, 100)


def test_the_same_drive_gives_the_same_images_on_any_number_of_threads(monkeypatch):
    import slam.report.loop_details as module

    pool = module.ThreadPoolExecutor
    once = make_album(rows(60), fabricate.street, 100_000)
    monkeypatch.setattr(module, "ThreadPoolExecutor", lambda: pool(max_workers=1))
    assert make_album(rows(60), fabricate.street, 100_000) == once


def test_frames_whose_images_are_lost_leave_their_rows_without():
    found = loop_details(WHOLE, lambda frame: None if frame == 110 else FLAT)
    captions = {row["query"]: row["caption"] for row in found["rows"]}
    assert "not in this page" in captions[110]
    assert "Frame 115 above, frame 15 below" in captions[115]
    assert "could not be read" in loop_details(WHOLE, lambda _: None)["rows"][0]["caption"]


@pytest.mark.parametrize("name", ["odometry", "corrected"])
def test_frames_are_where_the_drawing_has_them(name):
    figure = draw_interactive_map(WHOLE, name)
    drawn = inline_svg(figure, "map", "")
    data = map_data(WHOLE, name, figure)
    path = re.search(r'<path d="M ([^"]*)"[^>]*stroke-width: 1.8', drawn)[1].replace("L", "").split()
    ends = np.array(path, float).reshape(-1, 2)[[0, -1]]
    x, y, width, height = data["box"]
    left, bottom, right, top = data["window"]
    across, up = ((np.array(data["at"])[[0, -1]] - [left, bottom]) / [right - left, top - bottom]).T
    np.testing.assert_allclose(ends, np.stack([x + width * across, y + height * (1 - up)], axis=1), atol=0.05)


def test_of_many_rows_the_odd_ones_and_an_even_choice_of_the_others_are_shown():
    many = [LoopRow(k, k - 300, 1.0, k % 7 > 0, in_graph=k % 7 > 0 and k % 500 > 0) for k in range(300, 20_300)]
    shown = select_rows(many, 1000)
    assert len(shown) == 1000
    assert list(shown) == sorted(shown, key=lambda row: row.query)
    odd = {row.query for row in many if row.accepted and not row.in_graph}
    assert odd
    assert odd <= {row.query for row in shown}
    assert all(row.accepted for row in shown)
    assert np.diff([row.query for row in shown]).max() < 60
    assert select_rows(many[:1000], 1000) == tuple(many[:1000])


def test_rows_that_are_all_odd_leave_room_for_none_but_an_even_choice():
    shown = select_rows([LoopRow(k, 0, 1.0, accepted=True) for k in range(5000)], 100)
    assert len(shown) == 100
    assert np.diff([row.query for row in shown]).max() < 150
