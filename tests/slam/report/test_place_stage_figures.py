"""The picture of the stages shows each stage and the control, and says what is missing."""

import numpy as np

from place_recognition.evaluation.stages import StageResults, measure_reliability, measure_stages
from place_recognition.recognizer import Belief, StageScores
from slam.report.place_recognition_figures import CONTROL_NAME, plot_stages, stage_curves, stage_figures
from slam.report.style import render_png

TRUTH = np.eye(40, k=-20) > 0


def beliefs(shift: int) -> list[Belief]:
    """Right by `shift` images."""
    stages = [StageScores((query - 20 + shift,), 1.0, query - 20 + shift, 2.0) for query in range(20, 40)]
    return [
        Belief(query, query - 20 + shift, float(query), True, probability=0.9, stages=s)
        for query, s in enumerate(stages, start=20)
    ]


def results(shift: int = 0) -> StageResults:
    return measure_stages(beliefs(shift), TRUTH)


def test_there_is_a_curve_for_each_stage_and_the_control():
    figure = plot_stages(results(), results(1), measure_reliability(beliefs(0), TRUTH), "a $drive$")
    curves, candidates, probabilities = figure.axes
    labels = [text.get_text() for text in curves.get_legend().get_texts()]
    assert [label.split(":")[0] for label in labels] == ["temporal model", "geometry", "own score", CONTROL_NAME]
    assert [label[-5:] for label in labels] == ["1.000"] * 3 + ["0.000"]
    assert [bar.get_height() for bar in candidates.patches] == [1.0] * 3 + [0.0] * 3
    assert "calibration error 0.100" in probabilities.texts[0].get_text()
    assert render_png(figure).startswith(b"\x89PNG")


def test_what_is_missing_is_written_into_its_panel():
    for ax, text in zip(plot_stages(None, None, None, "x").axes, ("no ground", "no ground", "no prob"), strict=True):
        assert ax.texts[0].get_text().startswith(text)
    bare = measure_stages([Belief(30, 10, 1.0, True)], TRUTH)
    figure = plot_stages(bare, None, None, "x")
    assert figure.axes[1].texts[0].get_text() == "no candidates are reported"
    assert list(stage_curves(bare, None)) == ["temporal model"]
    assert render_png(figure).startswith(b"\x89PNG")


def test_a_report_gets_the_pictures_for_which_there_is_something():
    assert stage_figures(None, None) == []
    both = stage_figures(results(), measure_reliability(beliefs(0), TRUTH))
    assert [name for name, *_ in both] == ["candidates", "reliability"]
    assert [name for name, *_ in stage_figures(results(), None)] == ["candidates"]
