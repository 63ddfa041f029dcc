"""The pictures of place recognition show what they are given."""

from pathlib import Path

import numpy as np
import pytest

from place_recognition.evaluation.precision_recall import precision_recall
from place_recognition.evaluation.similarity_matrix import SimilarityMatrix
from place_recognition.recognizer import Belief
from slam.report.place_recognition_figures import plot_places, plot_precision_recall, reduce_to_cells
from slam.report.recall_table import DATASETS, RecallTable, format_latex, format_text, plot_table
from slam.report.style import render_png, save_png


def thin_diagonal(size: int) -> SimilarityMatrix:
    values = np.where(np.tri(size, k=-1) > 0, 0.0, np.nan).astype(np.float32)
    values[np.arange(size // 2, size), np.arange(size - size // 2)] = 1.0
    return SimilarityMatrix(values)


@pytest.mark.parametrize("size", [7, 601, 1999])
def test_a_line_of_one_image_is_drawn_however_large_the_matrix(size: int) -> None:
    rows, columns, cells = reduce_to_cells(thin_diagonal(size))
    assert max(cells.shape) <= 600 + 1
    assert (len(rows), len(columns)) == (cells.shape[0] + 1, cells.shape[1] + 1)
    lit = [row for row in range(len(cells)) if rows[row + 1] > size // 2]
    assert all(np.nanmax(cells[row]) == 1.0 for row in lit)


def test_a_matrix_of_sequences_fills_the_images_of_each() -> None:
    values = np.full((40, 40), np.nan, np.float32)
    values[np.ix_([10, 20, 30], [0, 10])] = np.arange(6).reshape(3, 2)
    rows, columns, cells = reduce_to_cells(SimilarityMatrix(values))
    assert rows.tolist() == [0, 10, 20, 30, 40]
    assert columns.tolist() == [0, 10, 20]
    assert cells[1:].tolist() == [[0, 1], [2, 3], [4, 5]]


def test_cells_of_a_folded_matrix_are_in_images() -> None:
    rows, _, _ = reduce_to_cells(SimilarityMatrix(np.zeros((5, 5), np.float32), step=4))
    assert rows.tolist() == [0, 4, 8, 12, 16, 20]


@pytest.mark.parametrize("truth", [None, np.eye(30, k=-15) > 0])
@pytest.mark.parametrize("stages", [("similarity",), ("similarity", "filtered")])
def test_there_is_a_panel_for_each_matrix_the_detections_and_the_truth(
    truth: np.ndarray | None, stages: tuple[str, ...]
) -> None:
    detections = np.array([[20, 5], [29, 3]])
    figure = plot_places("a $drive$", dict.fromkeys(stages, thin_diagonal(30)), detections, truth)
    panels = [ax for ax in figure.axes if ax.get_xlabel() == "earlier image"]
    assert len(panels) == len(stages) + 1 + (truth is not None)
    labels = [text.get_text() for text in panels[len(stages)].get_legend().get_texts()]
    assert labels == (["accepted"] if truth is None else ["true (1)", "false (1)"])
    assert render_png(figure).startswith(b"\x89PNG")


def test_a_drive_in_which_nothing_was_compared_can_be_drawn(tmp_path: Path) -> None:
    nothing = SimilarityMatrix(np.full((1, 1), np.nan, np.float32))
    save_png(plot_places("x", {"similarity": nothing}, np.empty((0, 2), np.int64), None), tmp_path / "x.png")
    assert (tmp_path / "x.png").stat().st_size > 0


def test_the_curve_has_a_circle_at_the_largest_recall_without_a_false_match() -> None:
    truth = np.eye(4, k=-2) > 0
    curve = precision_recall([Belief(2, 0, 5.0, True), Belief(3, 0, 1.0, True)], truth)
    ax = plot_precision_recall({"ours": curve}, "x").axes[0]
    circle = ax.lines[1]
    assert (list(circle.get_xdata()), list(circle.get_ydata())) == ([0.5], [1.0])
    assert ax.get_legend().get_texts()[0].get_text() == "ours: R@P100 0.500"


def test_without_truth_there_is_no_curve_but_a_picture() -> None:
    assert "no ground truth" in plot_precision_recall({}, "x").axes[0].texts[0].get_text()


MEASURED = {
    ("sequence-histograms", "default", "KITTI 00"): 93.25,
    ("sequence-histograms", "published", "KITTI 00"): 80.0,
}
TABLE = RecallTable(("sequence-histograms", "pixel-sequences"), MEASURED)


def test_the_table_has_both_presets_beside_the_published_value_and_marks_the_disputed_one() -> None:
    lines = format_text(TABLE).splitlines()
    assert lines[2].split("  ")[0] == "sequence-histograms"
    assert "81.5 / 80.0 / 93.2" in lines[2]
    assert "81.5* / - / -" in lines[2]
    assert lines[3].count("- / - / -") == len(DATASETS)
    assert lines[-1].startswith("* 76.8")


def test_the_latex_has_three_columns_for_each_data_set_and_nothing_unescaped() -> None:
    latex = format_latex(TABLE)
    body = [line for line in latex.splitlines() if line.endswith(r"\\")]
    assert len(body) == 4
    assert all(line.count("&") == 3 * len(DATASETS) for line in body[1:])
    assert body[0].count(r"\multicolumn{3}") == len(DATASETS)
    assert "%" not in latex.replace(r"\%", "").replace("% * 76.8", "")


def test_the_table_can_be_drawn() -> None:
    assert len([ax for ax in plot_table(TABLE).axes if ax.get_title() in DATASETS]) == len(DATASETS)
    assert render_png(plot_table(TABLE)).startswith(b"\x89PNG")
