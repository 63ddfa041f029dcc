"""The contract that every place recogniser meets, and the answer it gives."""

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray


def no_pixels() -> NDArray[np.float32]:
    """Where two images agree that were not compared, or do not: (0, 4)."""
    return np.empty((0, 4), np.float32)


@dataclass(frozen=True)
class Belief:
    """What a recogniser thinks about one query image.

    Attributes:
        query: id of the image asked about; a recogniser may answer late (one sequence, one place).
        match: the best earlier image, never one inside the recogniser's own exclusion window; None if there is none.
        score: larger is surer, on the paradigm's own scale; swept for precision-recall curves; 0 without a match.
        accepted: the score passes the paradigm's threshold and the match its geometric verification.
        inliers: matches that agree with one epipolar geometry; None where none was sought.
        verified: False where a geometric verification was tried and failed; such a match is never a detection.
        pixels: (inliers, 4) where the two images show those matches: x and y in the query's, x and y in the match's;
            none where that is not known.
    """

    query: int
    match: int | None
    score: float
    accepted: bool
    inliers: int | None = None
    verified: bool = True
    pixels: NDArray[np.float32] = field(default_factory=no_pixels, compare=False, repr=False)


class RowSink(Protocol):
    """Takes the rows of a recogniser's matrix as they are made, for the pictures of Figures 4.7, 4.8 and 4.12.

    A recogniser keeps no rows itself: over a long drive they would outgrow its map.
    """

    def add(
        self, query: int, matches: NDArray[np.int64], values: NDArray[np.float64], stage: str = "similarity"
    ) -> None:
        """Take one row.

        Args:
            query: id of the image asked about.
            matches: (K,) ids of the earlier images it was compared with.
            values: (K,) how alike they are, on the paradigm's own scale.
            stage: "similarity", or "filtered" for a row that has been through a matrix filter.
        """
        ...


class NoRows:
    """Takes no rows (a RowSink)."""

    def add(
        self, query: int, matches: NDArray[np.int64], values: NDArray[np.float64], stage: str = "similarity"
    ) -> None:
        """Forget the row."""


class PlaceRecognizer(Protocol):
    """Sees images once, in order, and answers from what it has seen: online and causal. Same input, same bits.

    One that counts words may say how many with a property `word_count`; one whose map holds more than numpy arrays may
    say how large it is with a property `map_bytes` (`place_recognition.evaluation.map_size` asks for both).
    """

    def observe(self, image_id: int, image: NDArray[np.uint8], travelled: float) -> list[Belief]:
        """Add an image and answer.

        Args:
            image_id: increases by one or more from call to call.
            image: (H, W) uint8, grey.
            travelled: way driven so far by odometry, metres.

        Returns:
            Beliefs that became ready with this image; over a whole drive exactly one for each image, in order,
            except for those that `finish` returns.
        """
        ...

    def finish(self) -> list[Belief]:
        """Return the beliefs of images that are still unanswered when the drive ends."""
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
