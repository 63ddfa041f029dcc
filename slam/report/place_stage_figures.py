"""Figures of the stages of place recognition: curves, recall of the candidates, reliability of probabilities."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from place_recognition.evaluation.precision_recall import PrecisionRecall
from place_recognition.evaluation.reliability import SURE_PROBABILITY, Reliability
from place_recognition.evaluation.stages import CANDIDATE_COUNTS, StageResults
from slam.report import colours
from slam.report.place_recognition_figures import draw_precision_recall
from slam.report.trajectory_figure import INK, new_figure, style_axes

CONTROL_NAME = "random images"
_PANEL = (4.9, 4.5)  # inches
_CURVES = {"temporal": "temporal model", "geometry": "geometry", "own": "own score"}
_BAR = 0.36  # width of a bar; two stand at each number of candidates
_MIN_AREA, _MAX_AREA = 30.0, 200.0  # of the points in the reliability diagram, square points of print


def plot_stages(
    stages: StageResults | None, control: StageResults | None, reliability: Reliability | None, title: str
) -> Figure:
    """Plot what each stage reaches, beside the control.

    Args:
        stages: results of the recogniser; None without ground truth.
        control: results of the control; None where it did not run.
        reliability: reliability of the probabilities; None where there are none.
        title: title of the figure.
    """
    figure = new_figure(3 * _PANEL[0], _PANEL[1])
    curves, candidates, probabilities = figure.subplots(1, 3)
    draw_precision_recall(curves, stage_curves(stages, control))
    draw_candidate_recall(candidates, stages, control)
    draw_reliability(probabilities, reliability)
    headings = ("Each stage by itself", "Candidates of the paradigm", "Reliability of the probability")
    for ax, heading in zip((curves, candidates, probabilities), headings, strict=True):
        ax.set_title(heading, color=INK, fontsize=11)
    figure.suptitle(title, color=INK, parse_math=False, fontweight="bold")
    return figure


def stage_figures(stages: StageResults | None, reliability: Reliability | None) -> list[tuple[str, str, str, Figure]]:
    """Plot the candidates and the probabilities of a run, as far as they are known: name, title, caption, figure."""
    figures = []
    if stages is not None and stages.candidate_recall:
        figure = new_figure(*_PANEL)
        draw_candidate_recall(figure.subplots(), stages, None)
        caption = "How often a true image is among the first candidates, before geometry and temporal model."
        figures.append(("candidates", "Candidates", caption, figure))
    if reliability is not None:
        figure = new_figure(*_PANEL)
        draw_reliability(figure.subplots(), reliability)
        caption = "On the dashed line a match given 0.9 is true nine times in ten."
        figures.append(("reliability", "Reliability", caption, figure))
    return figures


def stage_curves(stages: StageResults | None, control: StageResults | None) -> dict[str, PrecisionRecall]:
    """Return the curve of each stage by its name for people, the last stage first, then the control's last one."""
    if stages is None:
        return {}
    curves = {name: stages.curves[stage] for stage, name in _CURVES.items() if stage in stages.curves}
    return curves if control is None else curves | {CONTROL_NAME: control.curves["temporal"]}


def draw_candidate_recall(ax: Axes, stages: StageResults | None, control: StageResults | None) -> None:
    """Draw how often a true image is among the first candidates, beside the control."""
    _format(ax, "candidates of a query", "recall: share with a true image among them")
    ax.set(xticks=range(len(CANDIDATE_COUNTS)), xticklabels=CANDIDATE_COUNTS, ylim=(0.0, 1.2), yticks=np.arange(6) / 5)
    ax.grid(False, axis="x")
    if stages is None or not stages.candidate_recall:
        _write(ax, "no ground truth" if stages is None else "no candidates are reported")
        return
    _draw_bars(ax, stages.candidate_recall, -_BAR / 2, colours.CORRECTED, "the paradigm", "")
    if control is not None and control.candidate_recall:
        _draw_bars(ax, control.candidate_recall, _BAR / 2, colours.REJECTED, CONTROL_NAME, "///")
    clear = {"edgecolor": "none", "facecolor": "none", "labelcolor": INK}
    ax.legend(loc="upper center", ncols=2, fontsize=9, **clear)


def draw_reliability(ax: Axes, reliability: Reliability | None) -> None:
    """Draw the share of true matches over their probability: on the diagonal probabilities mean what they say."""
    _format(ax, "mean probability of the matches", "share of them that is true")
    ax.set(xlim=(-0.03, 1.03), ylim=(-0.03, 1.3), yticks=np.arange(6) / 5)
    if reliability is None:
        _write(ax, "no probabilities, or no ground truth")
        return
    ax.plot([0, 1], [0, 1], "--", color=colours.GROUND_TRUTH, lw=1.2)
    filled = reliability.counts > 0
    counts = reliability.counts[filled]
    areas = _MIN_AREA + (_MAX_AREA - _MIN_AREA) * np.log(counts) / max(float(np.log(counts.max())), 1.0)
    means, shares = reliability.mean_probabilities[filled], reliability.true_shares[filled]
    ax.plot(means, shares, "-", color=colours.CORRECTED, lw=1.0, alpha=0.6)
    ax.scatter(means, shares, s=areas, color=colours.CORRECTED, alpha=0.8, linewidths=0, zorder=3)
    text = (
        f"calibration error {reliability.expected_calibration_error:.3f}\n"
        f"false from {SURE_PROBABILITY} on: {reliability.sure_false} of {reliability.sure}\n"
        f"a larger point: more of the {counts.sum()} matches"
    )
    ax.text(0.02, 0.98, text, transform=ax.transAxes, ha="left", va="top", color=INK, fontsize=9)


def _draw_bars(ax: Axes, recall: Mapping[int, float], shift: float, colour: str, label: str, hatch: str) -> None:
    heights = [recall[count] for count in CANDIDATE_COUNTS]
    face = "none" if hatch else colour
    bars = ax.bar(
        np.arange(len(heights)) + shift, heights, _BAR, label=label, facecolor=face, edgecolor=colour, hatch=hatch
    )
    ax.bar_label(bars, [f"{height:.2f}" for height in heights], padding=2, fontsize=9, color=INK)


def _format(ax: Axes, xlabel: str, ylabel: str) -> None:
    style_axes(ax)
    ax.set_axisbelow(True)
    ax.set(xlabel=xlabel, ylabel=ylabel)


def _write(ax: Axes, text: str) -> None:
    ax.text(0.5, 0.5, text, transform=ax.transAxes, ha="center", color=INK)
