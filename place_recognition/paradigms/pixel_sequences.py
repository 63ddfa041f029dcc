"""A naive baseline: thumbnails compared pixel by pixel, and straight lines sought in the matrix of their differences.

Milford, Wyeth, 'SeqSLAM: Visual Route-Based Navigation for Sunny Summer Days and Stormy Winter Nights', ICRA 2012.
No geometry is asked. What differs from the paper:
* Lines end at the query, not around it, so that the answer comes at once.
* A line may begin before the map does; what is missing speaks neither for it nor against it.
* Of how much the best line stands out from all others not the quotient but the difference is taken: the paper's
  differences are normalised about zero, where quotients mean nothing.
"""

from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from place_recognition.image_processing.features import check_gray
from place_recognition.map.dense import absolute_differences
from place_recognition.map.growing import GrowingArray
from place_recognition.map.present_view import ExclusionWindow, ExclusionWindowConfig, is_blank
from place_recognition.recognizer import Belief, NoRows, RowSink

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class PixelSequencesConfig:
    """The paper's numbers, and those of the additions.

    Attributes:
        length: images of a sequence, d_s in the paper.
        speeds: images of the earlier pass for each one of this pass; the paper searches 0.8 to 1.2 or less.
        window: images before and after an image by which its difference is normalised, R_window in the paper, and
            from which the second best line must stay away.
        least_spread: standard deviation of the differences in such a window that counts at least, grey levels. Of two
            simulated towns R@P100 was 0.42 with 3, and 0.25 and 0.21 with 1: even streets are full of small minima.
        threshold: least score of an accepted match. First passes through the simulated towns reached 1.05.
        present: what counts as the present rather than the past, and the size of the thumbnails.
    """

    length: int = 10
    speeds: tuple[float, ...] = (0.6, 0.8, 1.0, 1.25, 1.6)
    window: int = 10
    least_spread: float = 3.0
    threshold: float = 1.1
    present: ExclusionWindowConfig = field(default_factory=ExclusionWindowConfig)


class PixelSequences:
    """Recognises places by sequences of thumbnails (a PlaceRecognizer). Answers each image at once.

    The score is how much better the best line fits than any that ends further away, on average over the sequence, in
    standard deviations of the differences around each image.
    """

    def __init__(self, config: PixelSequencesConfig | None = None, rows: RowSink | None = None) -> None:
        self.config = config or PixelSequencesConfig()
        self._present = ExclusionWindow(self.config.present)
        self._pictures: GrowingArray[np.uint8] = GrowingArray(np.uint8)
        self._blank: GrowingArray[np.bool_] = GrowingArray(np.bool_)
        length = self.config.length
        self._likeness = deque([np.empty(0, np.float32)] * length, maxlen=length)  # rows, the newest first
        steps = np.arange(length)
        self._offsets = np.round(np.outer(self.config.speeds, steps)).astype(np.int64)
        self._rows = NoRows() if rows is None else rows

    def observe(self, image_id: int, image: NDArray[np.uint8], travelled: float) -> list[Belief]:
        """Answer for this image and add it to the map.

        Args:
            image_id: greater than the one before.
            image: (H, W) uint8, grey, of any size.
            travelled: way driven so far, metres; NaN, or always the same, where it is not measured.
        """
        check_gray(image)
        picture = self._present.add(image_id, image, travelled)
        blank = is_blank(picture)
        self._likeness.appendleft(np.empty(0, np.float32) if blank else self._compare(picture.ravel()))
        self._pictures.extend(picture.reshape(1, -1))
        self._blank.extend(np.array([blank]))
        return [self._believe(image_id, blank)]

    def finish(self) -> list[Belief]:
        """Nothing is left unanswered."""
        return []

    def _compare(self, picture: NDArray[np.uint8]) -> Floats:
        """How much more alike each image so far (N,) is than those around it; 0 for blank ones."""
        if len(self._blank) == 0:
            return np.empty(0, np.float32)
        differences = absolute_differences(picture, self._pictures.rows)
        likeness = local_contrast(differences, self.config.window, self.config.least_spread * len(picture))
        likeness[self._blank.rows.reshape(-1)] = 0
        return likeness

    def _believe(self, image_id: int, blank: bool) -> Belief:
        ids = self._present.ids[: self._present.count_matchable()]
        if blank or len(ids) == 0:
            return Belief(image_id, None, 0.0, accepted=False)
        self._rows.add(image_id, ids, self._likeness[0][: len(ids)].astype(np.float64))
        sums = best_lines(tuple(self._likeness), self._offsets, len(ids)) / self.config.length
        self._rows.add(image_id, ids, sums.astype(np.float64), "filtered")
        best = int(sums.argmax())
        around = max(best - self.config.window, 0), best + self.config.window + 1
        others = np.concatenate([sums[: around[0]], sums[around[1] :]])
        # a line that is no better than chance is no rival
        score = float(sums[best] - max(others.max(initial=0.0), 0.0))
        if score <= 0:
            return Belief(image_id, None, 0.0, accepted=False)
        return Belief(image_id, int(ids[best]), score, accepted=score >= self.config.threshold)

    def state(self) -> dict[str, Any]:
        """Everything that changes from image to image, for a checkpoint."""
        return {
            "history": self._present.state(),
            "thumbnails": self._pictures.state(),
            "is_blank": self._blank.state(),
            "likeness": list(self._likeness),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from the state of another recogniser of this configuration.

        Raises:
            ValueError: of another length of sequences.
        """
        if len(state["likeness"]) != self.config.length:
            raise ValueError(f"expected sequences of {self.config.length} images, got {len(state['likeness'])}")
        self._present.restore(state["history"])
        self._pictures.restore(state["thumbnails"])
        self._blank.restore(state["is_blank"])
        self._likeness.extend(state["likeness"])


@njit(cache=True)
def local_contrast(differences: NDArray[np.int64], window: int, least_spread: float) -> Floats:
    """How far (N,) each difference (N,) is below the mean of its neighbours, in their standard deviations.

    The paper's local contrast enhancement (section III-B), with the sign turned: larger is more alike. The neighbours
    do not include the image itself, which would limit how far it can stand out.

    Args:
        differences: of one image to all before it.
        window: neighbours before and after.
        least_spread: standard deviation that counts at least.
    """
    out = np.zeros(len(differences), np.float32)
    for k in range(len(differences)):
        around = differences[max(k - window, 0) : k + window + 1]
        count = len(around) - 1
        if count > 0:
            mean = (around.sum() - differences[k]) / count
            square = -((differences[k] - mean) ** 2)
            for value in around:
                square += (value - mean) ** 2
            out[k] = (mean - differences[k]) / max(np.sqrt(max(square, 0.0) / count), least_spread)
    return out


@njit(cache=True)
def best_lines(rows: tuple[Floats, ...], offsets: NDArray[np.int64], count: int) -> Floats:
    """Largest sum (count,) along the lines that end at each of the first so many locations.

    Args:
        rows: likeness of the latest image to all before it, then of the one before, and so on.
        offsets: (S, L) locations by which each of S lines has gone back in each of the L rows.
        count: locations.
    """
    best = np.full(count, -np.inf, np.float32)
    for line in range(len(offsets)):
        total = np.zeros(count, np.float32)
        for i in range(len(rows)):
            offset = offsets[line, i]
            row = rows[i][: max(count - offset, 0)]
            part = total[offset : offset + len(row)]
            for k in range(len(part)):
                part[k] += row[k]
        best = np.maximum(best, total)
    return best
