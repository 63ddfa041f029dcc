"""SeqSLAM as published: thumbnails, a difference matrix of enhanced local contrast, and straight lines through it.

Milford, Wyeth, 'SeqSLAM: Visual Route-Based Navigation for Sunny Summer Days and Stormy Winter Nights', ICRA 2012.

The paper's: thumbnails of 64 x 32 pixels normalised in patches of 8 x 8, their mean absolute differences, the contrast
among R_window = 10 images, lines of d_s = 10 images at 0.8 to 1.2 of the speed, and the quotient of the best line and
the best one outside a window of 10 images.

OpenSeqSLAM's (Suenderhauf, Neubert, Protzel, 'Are we there yet? Challenging SeqSLAM on a 3000 km journey across all
four seasons', ICRA 2013 workshop), where the paper is silent; OpenSeqSLAM2.0 keeps them: lines are centred on the query
and have d_s + 1 images, speeds differ by 0.1, a window reaches half its length to either side, and differences are
shifted to be at least 0, without which a quotient means nothing.

Ours: the shift is the lower bound of any enhanced difference instead of the smallest one of the whole matrix, which is
known at the end only; and near the ends of the query, where OpenSeqSLAM gives no answer, lines are shorter, and near
those of the reference what lies outside counts as an image as alike as those around it.
`pixel-sequences` is the variant of this project, which answers at once: docs/decisions/seq_slam.md.
"""

import math
from collections import deque
from dataclasses import dataclass, field
from itertools import starmap
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from place_recognition.growing_array import GrowingArray
from place_recognition.image_processing.global_descriptors import ThumbnailConfig, is_blank, make_thumbnail
from place_recognition.map.descriptor_database import absolute_differences
from place_recognition.recognizer import (
    MAX_STAGE_CANDIDATES,
    MatrixSink,
    NullMatrixSink,
    ObservedImage,
    Proposals,
    select_apart,
)

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class SeqSlamConfig:
    """Settings of the paradigm.

    Attributes:
        sequence_length: distance of the first and the last image of a line, images; even (d_s in the paper).
        speed_ratios: images of the earlier pass for each image of this pass.
        window: images among which differences are enhanced, and around the best line, none of which is the second best
            (R_window in the paper); even.
        max_candidates: number of images that are proposed.
        min_separation: smallest number of images between any two of them.
        thumbnail: size and normalisation of the thumbnails.
    """

    sequence_length: int = 10
    speed_ratios: tuple[float, ...] = (0.8, 0.9, 1.0, 1.1, 1.2)
    window: int = 10
    max_candidates: int = MAX_STAGE_CANDIDATES
    min_separation: int = 4
    thumbnail: ThumbnailConfig = field(default_factory=ThumbnailConfig)


class SeqSlam:
    """Proposes images by lines through the difference matrix (a Proposer), half a sequence late.

    The score is 1 minus the quotient of a line and the best line that is not in the window around it.
    """

    def __init__(self, config: SeqSlamConfig | None = None, rows: MatrixSink | None = None) -> None:
        self.config = config or SeqSlamConfig()
        self._half = self.config.sequence_length // 2
        self._pictures: GrowingArray[np.uint8] = GrowingArray(np.uint8)
        self._blank: GrowingArray[np.bool_] = GrowingArray(np.bool_)
        # Enhanced differences of the latest images to all images before each of them.
        self._differences: deque[Floats] = deque(maxlen=self.config.sequence_length + 1)
        self._waiting: deque[tuple[int, int]] = deque()  # location and last matchable one of unanswered images
        self._reference_end: int | None = None  # number of images of the reference recording; None without one
        self._rows = NullMatrixSink() if rows is None else rows

    def observe(self, image: ObservedImage) -> list[Proposals]:
        """Add an image to the map, and propose images for the one half a sequence before it."""
        picture = make_thumbnail(image.pixels, self.config.thumbnail)
        blank = is_blank(picture)
        self._differences.append(self._compare(picture, blank))
        self._pictures.extend(picture.reshape(1, -1))
        self._blank.extend(np.array([blank]))
        self._waiting.append((image.location, image.last_matchable))
        return [self._answer(*self._waiting.popleft())] if len(self._waiting) > self._half else []

    def finish(self) -> list[Proposals]:
        """Propose images for the last ones, on lines that end with the recording."""
        waiting, self._waiting = self._waiting, deque()
        return list(starmap(self._answer, waiting))

    def end_reference(self) -> None:
        """Let no line begin in the images so far, and compare later ones with them alone (a ReferenceProposer)."""
        self._reference_end = len(self._blank)
        self._differences.clear()

    def _compare(self, picture: NDArray[np.uint8], blank: bool) -> Floats:
        """Enhanced differences (N,) to the images before; those of and to blank images are as usual as any."""
        pictures = self._pictures.rows[: self._reference_end]
        if blank or not len(self._blank):
            return np.full(len(pictures), _usual(self.config.window), np.float32)
        enhanced = enhance_contrast(absolute_differences(picture.ravel(), pictures), self.config.window // 2)
        enhanced[self._blank.rows.reshape(-1)[: self._reference_end]] = _usual(self.config.window)
        return enhanced

    def _answer(self, location: int, last_matchable: int) -> Proposals:
        """Propose images for the one at a location, by lines through the rows around it."""
        latest = len(self._blank) - 1
        rows = {latest - age: row for age, row in enumerate(reversed(self._differences))}
        near = [k for k in range(location - self._half, location + self._half + 1) if k in rows]
        count = min([last_matchable + 1, *(len(rows[k]) for k in near)])
        if count <= 0 or self._blank.rows.reshape(-1)[location]:
            return Proposals(location, last_matchable)
        steps = np.array(near) - location
        offsets = np.floor(np.outer(self.config.speed_ratios, steps) + 0.5).astype(np.int64)
        lines = smallest_lines(np.stack([rows[k][:count] for k in near]), offsets, _usual(self.config.window))
        self._rows.add(location, np.arange(count), -rows[location][:count].astype(np.float64))
        self._rows.add(location, np.arange(count), -lines.astype(np.float64), "filtered")
        return self._propose(location, last_matchable, lines)

    def _propose(self, location: int, last_matchable: int, lines: Floats) -> Proposals:
        """Propose the images whose lines are smallest, apart from one another, and smaller than usual."""
        order = np.argsort(lines, kind="stable")
        order = order[lines[order] < _usual(self.config.window)]
        chosen = select_apart(order.tolist(), self.config.max_candidates, self.config.min_separation)
        best = order[chosen].tolist()
        return Proposals(location, last_matchable, tuple(best), tuple(self._score(lines, k) for k in best))

    def _score(self, lines: Floats, k: int) -> float:
        """1 minus the quotient of a line and the best one outside the window around it; 0 where there is none."""
        half = self.config.window // 2
        others = np.concatenate([lines[: max(k - half, 0)], lines[k + half + 1 :]])
        second = float(others.min(initial=math.inf))
        return 1.0 - float(lines[k]) / second if 0 < second < math.inf else 0.0

    def state(self) -> dict[str, Any]:
        """Everything that changes from image to image, for a checkpoint."""
        return {
            "thumbnails": self._pictures.state(),
            "is_blank": self._blank.state(),
            "differences": list(self._differences),
            "waiting": [list(one) for one in self._waiting],
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from the state of another proposer of this configuration."""
        self._pictures.restore(state["thumbnails"])
        self._blank.restore(state["is_blank"])
        self._differences.extend(state["differences"])
        self._waiting.extend((location, last) for location, last in state["waiting"])


def _usual(window: int) -> float:
    """Return the enhanced difference of an image as alike as those around it, which is the shift of all of them.

    Among n numbers none is further below their mean than (n - 1) / sqrt(n) of their standard deviations.
    """
    count = window // 2 * 2 + 1
    return (count - 1) / math.sqrt(count)


@njit(cache=True)
def enhance_contrast(differences: NDArray[np.int64], half: int) -> Floats:
    """Return each difference (N,) relative to those around it, at least 0 and smaller where the images are alike.

    The local contrast enhancement of section III-B: the distance from the mean of the window in its standard
    deviations, shifted by the largest one below the mean that a whole window admits.

    Args:
        differences: (N,) differences of one image to those before it.
        half: number of images of the window on either side.
    """
    size = 2 * half + 1
    shift = (size - 1) / np.sqrt(size)
    out = np.full(len(differences), shift, np.float32)
    for k in range(len(differences)):
        around = differences[max(k - half, 0) : k + half + 1]
        if len(around) < 2:
            continue
        mean, square = around.mean(), 0.0
        for value in around:
            square += (value - mean) ** 2
        if square > 0:
            out[k] = max(shift + (differences[k] - mean) / np.sqrt(square / (len(around) - 1)), 0.0)
    return out


@njit(cache=True)
def smallest_lines(rows: Floats, offsets: NDArray[np.int64], outside: float) -> Floats:
    """Return for each location (N,) the smallest mean along the lines through it.

    Args:
        rows: (L, N) enhanced differences of L successive images to N locations.
        offsets: (S, L) distance of S lines from their location in each of the L rows.
        outside: value of what a line has before the first location and after the last one.
    """
    best = np.full(rows.shape[1], np.inf, np.float32)
    for line in range(len(offsets)):
        for k in range(rows.shape[1]):
            total = 0.0
            for i in range(len(rows)):
                at = k + offsets[line, i]
                total += rows[i, at] if 0 <= at < rows.shape[1] else outside
            best[k] = min(best[k], total / len(rows))
    return best
