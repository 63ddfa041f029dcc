"""The interface of every place recogniser, and the belief that it returns for each image."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

# Number of candidates of a query that are recorded: recall is measured at 1, 5 and 10.
MAX_STAGE_CANDIDATES = 10


def no_pixels() -> NDArray[np.float32]:
    """Return an empty array (0, 4): pixels of an image pair that was not compared or does not agree."""
    return np.empty((0, 4), np.float32)


@dataclass(frozen=True)
class StageScores:
    """What each stage before the last one answers for a query image by itself, so that each can be measured.

    Attributes:
        candidates: ids of the images that the paradigm itself proposes, best first, at most MAX_STAGE_CANDIDATES.
        own_score: score of the first of them on the paradigm's own scale, larger is better; None without candidates.
        geometry_match: id of the candidate that geometry alone would choose; None where none was verified.
        geometry_score: its evidence in powers of ten, -log10 of the number of false alarms; None likewise.
    """

    candidates: tuple[int, ...] = ()
    own_score: float | None = None
    geometry_match: int | None = None
    geometry_score: float | None = None

    def renumber(self, new_id: Callable[[int], int | None]) -> "StageScores":
        """Return the same answers with other image ids; what names an image without a new id is left out."""
        renumbered = [new_id(image) for image in self.candidates]
        candidates = tuple(image for image in renumbered if image is not None)
        geometry_match = None if self.geometry_match is None else new_id(self.geometry_match)
        return StageScores(
            candidates,
            self.own_score if candidates and renumbered[0] is not None else None,
            geometry_match,
            None if geometry_match is None else self.geometry_score,
        )


@dataclass(frozen=True)
class Belief:
    """Best match of one query image and how sure the recogniser is of it.

    Attributes:
        query: id of the query image; a recogniser may answer late, for example a whole sequence or place at once.
        match: id of the best earlier image, never one inside the recogniser's own exclusion window; None without match.
        score: confidence on the paradigm's own scale, larger is surer; precision-recall curves vary a threshold on it;
            0 without a match.
        accepted: whether the score passes the paradigm's threshold and the match its geometric verification.
        inliers: number of matches that agree with one epipolar geometry; None where none was fitted.
        verified: False where a geometric verification was tried and failed; such a match is never a detection.
        pixels: (inliers, 4) float32, x and y of these matches in the query image, then in the matched image; empty
            where they are not known.
        probability: probability that the match shows the same place; None where the recogniser computes none.
        stages: the answers of the earlier stages.
        answered_at: id of the latest image when the belief became ready, at least `query`; None where it is not known.
    """

    query: int
    match: int | None
    score: float
    accepted: bool
    inliers: int | None = None
    verified: bool = True
    pixels: NDArray[np.float32] = field(default_factory=no_pixels, compare=False, repr=False)
    probability: float | None = None
    stages: StageScores = StageScores()
    answered_at: int | None = None


class MatrixSink(Protocol):
    """Receives the rows of a recogniser's similarity matrix as they are made, for Figures 4.7, 4.8 and 4.12.

    A recogniser keeps no rows itself: over a long recording they would outgrow its map.
    """

    def add(
        self, query: int, matches: NDArray[np.int64], values: NDArray[np.float64], stage: str = "similarity"
    ) -> None:
        """Take one row.

        Args:
            query: id of the query image.
            matches: (K,) ids of the earlier images with which it was compared.
            values: (K,) similarities on the paradigm's own scale.
            stage: "similarity", or "filtered" for a row that has passed a matrix filter.
        """
        ...


class NullMatrixSink:
    """Discards all rows (a MatrixSink)."""

    def add(
        self, query: int, matches: NDArray[np.int64], values: NDArray[np.float64], stage: str = "similarity"
    ) -> None:
        """Discard the row."""


class PlaceRecognizer(Protocol):
    """Takes each image once, in order, and recognises places from the images so far: online and causal.

    The caller gives each image an id, and beliefs name images by their ids. Inside a recogniser an image is named by
    its location: its index, from 0, among all images observed. The same input gives the same beliefs, to the bit. A
    recogniser that counts visual words may have a property `word_count`, and one whose map holds more than NumPy arrays
    a property `map_bytes` (`place_recognition.evaluation.memory` reads both).
    """

    def observe(self, image_id: int, image: NDArray[np.uint8], distance_travelled_m: float) -> list[Belief]:
        """Add an image and return the beliefs that are ready now.

        Args:
            image_id: increases by one or more from call to call.
            image: (H, W) uint8, grey.
            distance_travelled_m: length of the path so far by odometry, metres; NaN, or always the same value, where
                it is not measured.

        Returns:
            Beliefs that became ready with this image. Over a whole recording there is exactly one for each image, in
            order, except for those that `finish` returns.
        """
        ...

    def finish(self) -> list[Belief]:
        """Return the beliefs about the images that are still unanswered when the recording ends."""
        ...

    def state(self) -> dict[str, Any]:
        """Everything that changes from image to image: dicts with text keys, lists, plain values and numpy arrays.

        For checkpoints; arrays are not copied. What follows from the configuration is left out.
        """
        ...

    def restore(self, state: dict[str, Any]) -> None:
        """Continue, bit for bit, from the state of another recogniser of the same configuration.

        Called before the first image; the arrays of the state belong to the recogniser from then on.

        Raises:
            KeyError, TypeError, ValueError: the state is of another recogniser.
        """
        ...
