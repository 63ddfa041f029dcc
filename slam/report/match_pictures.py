"""A sheet of matched images: the most certain wrong matches, and right ones, each beside the query and a true image."""

from collections.abc import Sequence

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from place_recognition.recognizer import Belief
from slam.datasets.prefetch import Recording
from slam.report import style
from slam.report.style import INK, new_figure

Image = NDArray[np.uint8]
Truth = NDArray[np.bool_]
Recordings = tuple[Recording[Image], Recording[Image]]

_ROWS = 4  # of wrong and of right matches
_WIDTH_PX = 320  # of an image on the sheet
_WIDTH_IN, _TITLE_IN = 3.2, 0.3  # of an image, and of the line above it


def plot_matches(
    title: str, beliefs: Sequence[Belief], images: Recordings, truth: Truth | None, tolerated: Truth | None = None
) -> Figure:
    """Plot the wrong matches of highest score, and right ones from all parts of the query.

    Args:
        title: title of the figure.
        beliefs: one for each query.
        images: the query and its reference.
        truth: (N, M) True where two images show one place; None if unknown: then all matches count as right.
        tolerated: (N, M) pairs that are neither right nor wrong, and are not shown; None for none.
    """
    rows = [(belief, "wrong") for belief in choose_wrong(beliefs, truth, tolerated)]
    rows += [(belief, "right" if truth is not None else "match") for belief in choose_right(beliefs, truth)]
    height_in = _height_in(images[0][rows[0][0].query]) if rows else 1.0
    figure = new_figure(3 * _WIDTH_IN, height_in * max(len(rows), 1) + 0.6)
    panels = figure.subplots(max(len(rows), 1), 3, squeeze=False)
    for (belief, label), cells in zip(rows, panels, strict=False):
        _draw_row(cells, belief, label, images, truth)
    if not rows:
        for ax in panels[0]:
            ax.axis("off")
        panels[0][1].text(0.5, 0.5, "no match", ha="center", color=INK)
    figure.suptitle(title, color=INK, parse_math=False, fontweight="bold")
    return figure


def choose_wrong(beliefs: Sequence[Belief], truth: Truth | None, tolerated: Truth | None) -> list[Belief]:
    """Return the wrong matches of highest score, highest first."""
    if truth is None:
        return []
    wrong = [
        belief
        for belief in beliefs
        if belief.is_detection and belief.match is not None and not truth[belief.query, belief.match]
    ]
    if tolerated is not None:
        wrong = [belief for belief in wrong if not tolerated[belief.query, belief.match]]
    return sorted(wrong, key=lambda belief: -belief.score)[:_ROWS]


def choose_right(beliefs: Sequence[Belief], truth: Truth | None) -> list[Belief]:
    """Return right matches, evenly spread over the query."""
    right = [
        belief
        for belief in beliefs
        if belief.is_detection and belief.match is not None and (truth is None or truth[belief.query, belief.match])
    ]
    count = min(_ROWS, len(right))
    return [right[k * len(right) // count + len(right) // (2 * count)] for k in range(count)]


def _height_in(image: Image) -> float:
    return _WIDTH_IN * image.shape[0] / image.shape[1] + _TITLE_IN


def _draw_row(cells: NDArray[np.object_], belief: Belief, label: str, images: Recordings, truth: Truth | None) -> None:
    assert belief.match is not None
    true = None if truth is None else _middle_true(truth[belief.query])
    colour = style.REJECTED if label == "wrong" else style.ACCEPTED
    _draw_image(cells[0], images[0][belief.query], f"query {belief.query}", INK)
    found = f"{label}: {belief.match}, score {belief.score:.3g}" + ("" if belief.accepted else ", not accepted")
    _draw_image(cells[1], images[1][belief.match], found, colour)
    if true is None:
        cells[2].axis("off")
        cells[2].text(0.5, 0.5, "no true image", ha="center", color=INK)
    else:
        _draw_image(cells[2], images[1][true], f"true: {true}", INK)


def _middle_true(row: NDArray[np.bool_]) -> int | None:
    """Return the middle one of the true images of a query, None where it has none."""
    true = np.flatnonzero(row)
    return int(true[len(true) // 2]) if len(true) else None


def _draw_image(ax: Axes, image: Image, title: str, colour: str) -> None:
    height = max(round(image.shape[0] * _WIDTH_PX / image.shape[1]), 1)
    small = cv2.resize(image, (_WIDTH_PX, height), interpolation=cv2.INTER_AREA)
    ax.imshow(small, cmap="gray", vmin=0, vmax=255)
    ax.set(xticks=[], yticks=[])
    ax.set_title(title, color=colour, fontsize=9, parse_math=False)
    for spine in ax.spines.values():
        spine.set(color=colour, linewidth=2.0)
