"""The contract of a paradigm: it takes each image once and proposes earlier images that may show the same place.

A paradigm is a proposer: a map of its own, and a score of its own. What follows is the same for all paradigms
(`place_recognition.staged_recognizer`): geometric verification, and a decision over the images around.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.local_features import LocalFeatures


@dataclass(frozen=True)
class ObservedImage:
    """An image as a proposer sees it.

    Attributes:
        location: its index, from 0, among all images observed.
        pixels: (H, W) uint8, grey.
        features: its local features, strongest first.
        distance_travelled_m: length of the path so far; NaN, or always the same, where it is not measured.
        last_matchable: latest location that it may be matched with, -1 for none.
    """

    location: int
    pixels: NDArray[np.uint8]
    features: LocalFeatures
    distance_travelled_m: float
    last_matchable: int


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

    A proposer that counts visual words may have a property `word_count`.
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
