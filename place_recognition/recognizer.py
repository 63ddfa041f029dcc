"""The interfaces of place recognition: recognisers with their beliefs, and paradigms with their proposals.

A paradigm is a proposer: a map of its own, and a score of its own. What follows is the same for all paradigms
(`place_recognition.staged_recognizer`): geometric verification, and a decision over the images around.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.local_features import LocalFeatures

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
        score: confidence on the paradigm's own scale, larger is surer; precision-recall curves vary a threshold on it.
            Has no meaning without a match.
        accepted: whether the score passes the paradigm's threshold and the match its geometric verification.
        inliers: number of matches that agree with one epipolar geometry; None where none was fitted.
        verified: False where a geometric verification was tried and failed, or was not worth a trial.
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

    @property
    def is_detection(self) -> bool:
        """Whether the match counts in a precision-recall curve: where it is verified, or has a probability.

        A probability holds what the images around say too; geometry of the image alone may fail.
        """
        return self.match is not None and (self.verified or self.probability is not None)

    def keep_images(self, is_kept: Callable[[int], bool]) -> "Belief":
        """Return the belief without the match and the candidates that are not kept."""
        stages = self.stages.renumber(lambda image: image if is_kept(image) else None)
        if self.match is None or is_kept(self.match):
            return replace(self, stages=stages)
        return Belief(self.query, None, 0.0, False, stages=stages, answered_at=self.answered_at)


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
    a property `map_bytes` (`place_recognition.evaluation.memory` reads both). One that sees colour has a property
    `takes_color`, which is true.
    """

    def observe(self, image_id: int, image: NDArray[np.uint8], distance_travelled_m: float) -> list[Belief]:
        """Add an image and return the beliefs that are ready now.

        Args:
            image_id: increases by one or more from call to call.
            image: (H, W) uint8, grey, or (H, W, 3), red first; only some global descriptors see the colour.
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


class TwoRecordingRecognizer(PlaceRecognizer, Protocol):
    """A recogniser that can be shown a reference recording first, and then a query."""

    def end_reference(self) -> None:
        """End the reference: from now on images are matched with those of the reference alone."""
        ...


@runtime_checkable
class ForgetfulRecognizer(Protocol):
    """A recogniser whose map does not grow with each image of a place that it knows already.

    Attributes:
        can_forget: whether it can forget images.
    """

    can_forget: bool

    def forget(self, image_id: int) -> None:
        """Keep nothing of an image that was answered: it is never a match again.

        For images of places that other images show as well.
        """
        ...


def can_forget(recognizer: PlaceRecognizer) -> bool:
    """Whether a recogniser forgets images on request."""
    return isinstance(recognizer, ForgetfulRecognizer) and recognizer.can_forget


def takes_color(recognizer: PlaceRecognizer) -> bool:
    """Whether a recogniser sees colour, and is to be given it where the recording has it."""
    return bool(getattr(recognizer, "takes_color", False))


@dataclass(frozen=True)
class ObservedImage:
    """An image as a proposer sees it.

    Attributes:
        location: its index, from 0, among all images observed.
        pixels: (H, W) uint8, grey.
        features: its local features, strongest first.
        distance_travelled_m: length of the path so far; NaN, or always the same, where it is not measured.
        last_matchable: latest location that it may be matched with, -1 for none.
        color: (H, W, 3) uint8, red first; None where the recording is grey.
    """

    location: int
    pixels: NDArray[np.uint8]
    features: LocalFeatures
    distance_travelled_m: float
    last_matchable: int
    color: NDArray[np.uint8] | None = None


@dataclass(frozen=True)
class Proposals:
    """What a paradigm proposes for one query image.

    Attributes:
        query: location of the query image.
        last_matchable: latest location that it may be matched with.
        locations: the proposed earlier locations, best first, no two of them so near that they show the same.
        scores: their scores on the paradigm's own scale; larger is better.
    """

    query: int
    last_matchable: int
    locations: tuple[int, ...] = ()
    scores: tuple[float, ...] = ()


class Proposer(Protocol):
    """Proposes earlier images, online and causally: the same input gives the same proposals, to the bit.

    A proposer that counts visual words may have a property `word_count`, and one that keeps something from image to
    image the method of a `ReferenceProposer`.
    """

    def observe(self, image: ObservedImage) -> list[Proposals]:
        """Add an image to the map, and return the proposals that are ready now, in the order of their queries."""
        ...

    def finish(self) -> list[Proposals]:
        """Return the proposals for the images that are still unanswered when the recording ends."""
        ...

    def state(self) -> dict[str, Any]:
        """Everything that changes from image to image, for a checkpoint (`PlaceRecognizer.state`)."""
        ...

    def restore(self, state: dict[str, Any]) -> None:
        """Continue, bit for bit, from the state of another proposer of the same configuration."""
        ...


@runtime_checkable
class ReferenceProposer(Protocol):
    """A proposer that keeps something from image to image, such as tracks, which must not reach another recording."""

    def end_reference(self) -> None:
        """End a reference recording, after `finish`: the next image is no neighbour of the last one."""
        ...


@runtime_checkable
class ForgetfulProposer(Protocol):
    """A proposer that can leave images out of its map."""

    def forget(self, location: int) -> None:
        """Never propose the image at a location, and keep nothing of it."""
        ...


def select_apart(locations: Sequence[int], max_count: int, min_separation: int) -> list[int]:
    """Return the indices of up to `max_count` of the locations, in their order, no two of them nearer than that."""
    chosen: list[int] = []
    for index, location in enumerate(locations):
        if all(abs(location - locations[other]) >= min_separation for other in chosen):
            chosen.append(index)
            if len(chosen) == max_count:
                break
    return chosen


def propose_best(
    image: ObservedImage,
    similarities: NDArray[np.floating[Any]],
    max_count: int,
    min_separation: int,
    scores: NDArray[np.floating[Any]] | None = None,
) -> Proposals:
    """Propose the locations with the largest positive similarities (N,), apart from one another.

    Args:
        image: the query image.
        similarities: (N,) similarity of the image with each of the first N locations.
        max_count: largest number of proposals.
        min_separation: smallest number of images between any two of them.
        scores: (N,) the paradigm's score of each location, where it is not the similarity.
    """
    # Of a neighbourhood of 2 s - 1 locations one is proposed, so the best of these many hold all that can be.
    enough = min(len(similarities), 2 * min_separation * max_count)
    best = np.argpartition(-similarities, enough - 1)[:enough] if enough else np.empty(0, np.int64)
    best = best[np.lexsort((best, -similarities[best]))]
    best = best[similarities[best] > 0]
    chosen = best[select_apart(best.tolist(), max_count, min_separation)]
    values = (similarities if scores is None else scores)[chosen]
    return Proposals(image.location, image.last_matchable, tuple(chosen.tolist()), tuple(values.tolist()))


class RandomImages:
    """Proposes random earlier images (a Proposer)."""

    def __init__(self, seed: int, max_candidates: int = MAX_STAGE_CANDIDATES) -> None:
        self._seed, self._max_candidates = seed, max_candidates

    def observe(self, image: ObservedImage) -> list[Proposals]:
        """Propose random locations of those that may be matched, all of the same score."""
        count = min(self._max_candidates, image.last_matchable + 1)
        # A generator of its own for each image: no state to keep.
        rng = np.random.default_rng((self._seed, image.location))
        locations = rng.choice(image.last_matchable + 1, count, replace=False) if count else np.empty(0, np.int64)
        return [Proposals(image.location, image.last_matchable, tuple(locations.tolist()), (0.0,) * count)]

    def finish(self) -> list[Proposals]:
        """Return nothing: each image is answered at once."""
        return []

    def state(self) -> dict[str, Any]:
        """Nothing."""
        return {}

    def restore(self, state: dict[str, Any]) -> None:
        """Nothing."""
