"""Two naive baselines without local features: global descriptors, and SeqSLAM on thumbnails.

The first proposes the images whose global descriptors, a histogram of oriented gradients or any network, have the
largest cosine with that of the query (eq. 4.3). SeqSLAM compares thumbnails pixel by pixel and seeks straight lines in
the difference matrix:

Milford, Wyeth, 'SeqSLAM: Visual Route-Based Navigation for Sunny Summer Days and Stormy Winter Nights', ICRA 2012.
Deviations from the paper:
* Lines end at the query instead of being centred on it, so that the answer comes at once.
* A line may begin before the map does; missing images add 0 to its sum.
* The score is the difference between a line and the best line that ends elsewhere, not their quotient: the differences
  are normalised about zero, where quotients mean nothing.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from place_recognition.growing_array import GrowingArray
from place_recognition.image_processing.global_descriptors import (
    GlobalDescriptor,
    ThumbnailConfig,
    is_blank,
    make_thumbnail,
)
from place_recognition.map.descriptor_database import DescriptorDatabase, absolute_differences
from place_recognition.recognizer import (
    MAX_STAGE_CANDIDATES,
    MatrixSink,
    NullMatrixSink,
    ObservedImage,
    Proposals,
    propose_best,
)

Floats = NDArray[np.float32]

_BESIDE_FRAMES = 10  # images around the most similar one, which may show the same
_MIN_OTHERS = 20  # images from which mean and standard deviation are known well enough
_MIN_COSINE_STD = 0.02
_NEUTRAL_SCORE = 3.7  # distinctness at which the likelihood ratio is one


@dataclass(frozen=True)
class PixelSequencesConfig:
    """Settings of the paradigm: the paper's numbers and those of the deviations.

    Attributes:
        sequence_length: number of images of a sequence (d_s in the paper).
        speed_ratios: images of the earlier pass for each image of this pass; the paper searches 0.8 to 1.2 or less.
        window: number of images before and after an image by which its difference is normalised (R_window in the
            paper). The best other line must end further away than this.
        min_contrast: lower bound of the standard deviation of the differences in a window, grey levels. In two
            simulated towns R@P100 was 0.42 with 3, and 0.25 and 0.21 with 1: the matrix is full of small minima.
        max_candidates: number of images that are proposed.
        min_separation: smallest number of images between any two of them.
        thumbnail: size and normalisation of the thumbnails.
    """

    sequence_length: int = 10
    speed_ratios: tuple[float, ...] = (0.6, 0.8, 1.0, 1.25, 1.6)
    window: int = 10
    min_contrast: float = 3.0
    max_candidates: int = MAX_STAGE_CANDIDATES
    min_separation: int = 4
    thumbnail: ThumbnailConfig = field(default_factory=ThumbnailConfig)


class PixelSequences:
    """Proposes images by sequences of thumbnails (a Proposer).

    The score is the mean over the sequence by which a line exceeds the best line that ends outside the window around
    it, in standard deviations of the differences around each image.
    """

    def __init__(self, config: PixelSequencesConfig | None = None, rows: MatrixSink | None = None) -> None:
        self.config = config or PixelSequencesConfig()
        self._pictures: GrowingArray[np.uint8] = GrowingArray(np.uint8)
        self._blank: GrowingArray[np.bool_] = GrowingArray(np.bool_)
        length = self.config.sequence_length
        self._similarity = deque([np.empty(0, np.float32)] * length, maxlen=length)  # rows, the newest first
        # A line of speed ratio v is v * i locations further back, i images before the query.
        steps = np.arange(length)
        self._offsets = np.round(np.outer(self.config.speed_ratios, steps)).astype(np.int64)
        self._reference_end: int | None = None  # number of images of the reference recording; None without one
        self._rows = NullMatrixSink() if rows is None else rows

    def observe(self, image: ObservedImage) -> list[Proposals]:
        """Propose the ends of the best lines, and add the image to the map."""
        picture = make_thumbnail(image.pixels, self.config.thumbnail)
        blank = is_blank(picture)
        self._similarity.appendleft(np.empty(0, np.float32) if blank else self._compare(picture.ravel()))
        self._pictures.extend(picture.reshape(1, -1))
        self._blank.extend(np.array([blank]))
        return [Proposals(image.location, image.last_matchable) if blank else self._propose(image)]

    def finish(self) -> list[Proposals]:
        """Return nothing: each image is answered at once."""
        return []

    def end_reference(self) -> None:
        """Let no line begin in the images so far, and compare later ones with them alone (a ReferenceProposer)."""
        self._reference_end = len(self._blank)
        for _ in range(self.config.sequence_length):
            self._similarity.append(np.empty(0, np.float32))

    def _compare(self, picture: NDArray[np.uint8]) -> Floats:
        """Similarity (N,) of each image so far, relative to those around it (`local_contrast`); 0 for blank ones."""
        if len(self._blank) == 0:
            return np.empty(0, np.float32)
        differences = absolute_differences(picture, self._pictures.rows[: self._reference_end])
        similarity = local_contrast(differences, self.config.window, self.config.min_contrast * len(picture))
        similarity[self._blank.rows.reshape(-1)[: self._reference_end]] = (
            0  # all blank images look alike, wherever they are
        )
        return similarity

    def _propose(self, image: ObservedImage) -> Proposals:
        count = image.last_matchable + 1
        if count == 0:
            return Proposals(image.location, image.last_matchable)
        self._rows.add(image.location, np.arange(count), self._similarity[0][:count].astype(np.float64))
        sums = best_lines(tuple(self._similarity), self._offsets, count) / self.config.sequence_length
        self._rows.add(image.location, np.arange(count), sums.astype(np.float64), "filtered")
        best = int(sums.argmax())
        around = max(best - self.config.window, 0), best + self.config.window + 1
        others = np.concatenate([sums[: around[0]], sums[around[1] :]])
        # A negative sum is below chance: such a line must not raise the score.
        scores = sums - max(float(others.max(initial=0.0)), 0.0)
        return propose_best(image, np.maximum(sums, 0), self.config.max_candidates, self.config.min_separation, scores)

    def state(self) -> dict[str, Any]:
        """Everything that changes from image to image, for a checkpoint."""
        return {
            "thumbnails": self._pictures.state(),
            "is_blank": self._blank.state(),
            "similarity": list(self._similarity),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from the state of another proposer of this configuration.

        Raises:
            ValueError: of another length of sequences.
        """
        if len(state["similarity"]) != self.config.sequence_length:
            raise ValueError(
                f"expected sequences of {self.config.sequence_length} images, got {len(state['similarity'])}"
            )
        self._pictures.restore(state["thumbnails"])
        self._blank.restore(state["is_blank"])
        self._similarity.extend(state["similarity"])


@njit(cache=True)
def local_contrast(differences: NDArray[np.int64], window: int, min_std: float) -> Floats:
    """Return how far (N,) each difference is below the mean of its neighbours, in their standard deviations.

    The paper's local contrast enhancement (section III-B) with opposite sign: larger is more similar. The neighbours
    do not include the image itself, which would limit how far it can stand out.

    Args:
        differences: (N,) differences of one image to all images before it.
        window: number of neighbours before and after.
        min_std: lower bound of the standard deviation.
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
            out[k] = (mean - differences[k]) / max(np.sqrt(max(square, 0.0) / count), min_std)
    return out


@njit(cache=True)
def best_lines(rows: tuple[Floats, ...], offsets: NDArray[np.int64], count: int) -> Floats:
    """Return the largest sum (count,) along the lines that end at each of the first `count` locations.

    Args:
        rows: L rows, the similarities of the latest image to all before it, then of the one before, and so on.
        offsets: (S, L) locations by which each of S lines has gone back in each of the L rows.
        count: number of locations.
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


@dataclass(frozen=True)
class GlobalDescriptorConfig:
    """Settings of the paradigm.

    Attributes:
        max_candidates: number of images that are proposed.
        min_separation: smallest number of images between any two of them.
    """

    max_candidates: int = MAX_STAGE_CANDIDATES
    min_separation: int = 4


def cosines(similarities: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the cosines (N,) of a query and all images as their scores."""
    return similarities


def distinctness(similarities: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return by how many standard deviations each cosine (N,) exceeds those of images far from the most similar one.

    In other light all cosines fall, those of revisits as well: what is usual tells more than a threshold. Where images
    are too few to tell what is usual, the score is one that says nothing.
    """
    if len(similarities) == 0:
        return similarities
    away = np.abs(np.arange(len(similarities)) - similarities.argmax()) > _BESIDE_FRAMES
    if np.count_nonzero(away) < _MIN_OTHERS:
        return np.full(len(similarities), _NEUTRAL_SCORE)
    others = similarities[away]
    return (similarities - others.mean()) / max(float(others.std()), _MIN_COSINE_STD)


class GlobalDescriptorMatching:
    """Proposes images by one descriptor per image (a Proposer); the score is its cosine, or how distinct that is."""

    def __init__(
        self,
        descriptor: GlobalDescriptor,
        config: GlobalDescriptorConfig | None = None,
        rows: MatrixSink | None = None,
        score: Callable[[NDArray[np.float64]], NDArray[np.float64]] = cosines,
    ) -> None:
        self.config = config or GlobalDescriptorConfig()
        self._descriptor, self._score = descriptor, score
        self._map = DescriptorDatabase()
        self._rows = NullMatrixSink() if rows is None else rows

    @property
    def takes_color(self) -> bool:
        """Whether the descriptor sees colour."""
        return self._descriptor.takes_color

    def observe(self, image: ObservedImage) -> list[Proposals]:
        """Propose the most similar images, and add this one to the map."""
        color = image.color if self._descriptor.takes_color else None
        vector = self._descriptor.describe(image.pixels if color is None else color)
        similarities = self._map.similarities(vector, image.last_matchable + 1)
        self._rows.add(image.location, np.arange(len(similarities)), similarities)
        self._map.add(vector)
        scores = self._score(similarities)
        return [propose_best(image, similarities, self.config.max_candidates, self.config.min_separation, scores)]

    def finish(self) -> list[Proposals]:
        """Return nothing: each image is answered at once."""
        return []

    def state(self) -> dict[str, Any]:
        """Everything that changes from image to image, for a checkpoint."""
        return {"descriptors": self._map.state()}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from the state of another proposer of this configuration."""
        self._map.restore(state["descriptors"])
