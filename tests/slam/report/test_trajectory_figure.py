from dataclasses import replace

import numpy as np
import pytest
from matplotlib import image
from matplotlib.figure import Figure

from slam.errors import OutputError
from slam.report.charts import draw_error_over_distance, draw_inliers, draw_stage_times
from slam.report.interactive_map import draw_interactive_map
from slam.report.style import render_png, save_png
from slam.report.trajectory_figure import draw_before_after
from slam.run_result import PointCloud

from . import fabricate

WHOLE = fabricate.record()
DEGENERATE = {
    "no truth": fabricate.without_truth(WHOLE),
    "no loops": fabricate.without_loops(WHOLE),
    "straight": fabricate.straight(),
    "standing": fabricate.standing(),
    "two frames": fabricate.record(2),
    "hostile name": replace(WHOLE, name=r"$\frac{<b>日本"),
    "no landmarks": replace(WHOLE, map_after=PointCloud(np.empty((0, 3)), np.empty(0, np.uint8))),
}


def texts(figure: Figure) -> str:
    return " ".join(ax.get_title() + ax.get_xlabel() for ax in figure.axes) + figure.get_suptitle()


def test_the_same_record_gives_the_same_bytes():
    assert render_png(draw_before_after(WHOLE)) == render_png(draw_before_after(fabricate.record()))


def test_the_picture_carries_no_date_and_no_version():
    assert b"tEXt" not in render_png(draw_before_after(WHOLE))


@pytest.mark.parametrize("name", DEGENERATE)
def test_every_drive_can_be_drawn(name, tmp_path):
    save_png(draw_before_after(DEGENERATE[name]), tmp_path / "x.png")
    assert image.imread(tmp_path / "x.png").std() > 0.01


@pytest.mark.parametrize("name", DEGENERATE)
@pytest.mark.parametrize("draw", [draw_error_over_distance, draw_inliers, draw_stage_times])
def test_every_drive_has_its_charts_or_none(name, draw):
    figure = draw(DEGENERATE[name])
    assert figure is None or len(render_png(figure)) > 1000


def test_there_is_no_error_chart_without_ground_truth():
    assert draw_error_over_distance(DEGENERATE["no truth"]) is None


def test_titles_name_the_error_and_its_alignment():
    assert "ATE 5.42 m, SE(3) alignment" in texts(draw_before_after(WHOLE))
    assert "ATE 0.83 m, SE(3) alignment" in texts(draw_before_after(WHOLE))


def test_titles_say_when_there_is_no_ground_truth():
    assert texts(draw_before_after(DEGENERATE["no truth"])).count("no ground truth") == 2


def test_both_panels_show_the_same_window_with_equal_axes():
    left, right = draw_before_after(WHOLE).axes[:2]
    assert left.get_xlim() == right.get_xlim()
    assert left.get_ylim() == right.get_ylim()
    assert left.get_aspect() == right.get_aspect() == 1.0


def test_both_heights_are_drawn_to_one_scale_that_does_not_magnify_a_flat_drive():
    left, right = draw_before_after(WHOLE).axes[2:]
    assert left.get_ylim() == right.get_ylim()
    assert np.diff(left.get_ylim())[0] >= 4.0


def test_a_stray_landmark_does_not_widen_the_window():
    (ax,) = draw_interactive_map(WHOLE, "odometry").axes
    assert WHOLE.map_before.points[:, 0].max() == 5000
    assert ax.get_xlim()[1] < 3 * fabricate.RADIUS


def test_the_legend_counts_accepted_and_rejected_loops():
    figure = draw_before_after(WHOLE)
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    kept = sum(row.in_graph for row in WHOLE.loops)
    rejected = sum(row.accepted and not row.in_graph for row in WHOLE.loops)
    assert {f"accepted loop ({kept})", f"rejected loop ({rejected})"} <= set(labels)


def test_the_record_is_left_as_it_was():
    before = WHOLE.corrected.copy()
    draw_before_after(WHOLE)
    np.testing.assert_array_equal(WHOLE.corrected, before)


def test_a_picture_that_cannot_be_written_names_the_file(tmp_path):
    with pytest.raises(OutputError, match=r"nowhere/x\.png: cannot write the picture"):
        save_png(draw_inliers(WHOLE), tmp_path / "nowhere" / "x.png")
