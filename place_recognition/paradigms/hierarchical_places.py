"""Place recognition by places with visual words of their own: first the place is found, then the image in it.

Tsintotas, Bampis, Gasteratos, 'Assigning Visual Words to Places for Loop Closure Detection', ICRA 2018; section 4.4.3
of the chapter. Deviations of the default from the paper (reasons and figures: docs/decisions/hierarchical_places.md):
* Several of the likeliest places are searched, and the places beside the best one.
* The best image of a place is the one with the most mutual matches, not the one with the most nearest descriptors. It
  is sought among every third image.
* Each word votes once (`vote_for_places`); the last place ends with the recording.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from place_recognition.belief.voting import PlaceVotes, expand_spans, vote_for_places
from place_recognition.image_processing.matching import count_matches
from place_recognition.map.image_history import ImageHistory
from place_recognition.map.place_map import PlaceMap, PlaceSegmentation, PlaceSegmentationConfig
from place_recognition.recognizer import (
    MAX_STAGE_CANDIDATES,
    MatrixSink,
    NullMatrixSink,
    ObservedImage,
    Proposals,
    select_apart,
)
from place_recognition.vocabulary.growing_neural_gas import GasConfig, grow_gas
from place_recognition.vocabulary.word_tree import HybridWordIndex, WordIndex

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class HierarchicalPlacesConfig:
    """Settings of the paradigm: the paper's numbers and those of the deviations.

    Attributes:
        word_features: number of strongest features of an image that make words (nu in the paper).
        voting_features: number of strongest features of an image that vote; half of the paper's.
        max_places: number of likeliest places that are searched.
        neighbor_places: number of places before and after the likeliest one that are searched too.
        image_stride: every `image_stride`-th image of a place is compared with the query.
        ranking_features: number of strongest features of each image used for this comparison.
        ranking_ratio: largest ratio of nearest to second nearest descriptor distance of its matches.
        max_candidates: number of best images that are proposed.
        min_separation: smallest number of images between any two of them.
        distinct_votes: whether a word votes once, however often it is hit; in the paper it votes as often.
        seed: seed of the order in which the growing neural gas sees the descriptors.
        place: when a place ends.
        gas: growing neural gas, which makes the words of a place.
    """

    word_features: int = 300
    voting_features: int = 150
    max_places: int = 5
    neighbor_places: int = 1
    image_stride: int = 2
    ranking_features: int = 150
    ranking_ratio: float = 0.8
    max_candidates: int = MAX_STAGE_CANDIDATES
    min_separation: int = 4
    distinct_votes: bool = True
    seed: int = 0
    place: PlaceSegmentationConfig = field(default_factory=PlaceSegmentationConfig)
    gas: GasConfig = field(default_factory=GasConfig)


class HierarchicalPlaces:
    """Proposes images by the visual words that each place has of its own (a Proposer).

    The score of an image is -log10 of the probability of its place's votes by chance.
    """

    def __init__(
        self,
        history: ImageHistory,
        config: HierarchicalPlacesConfig | None = None,
        rows: MatrixSink | None = None,
        index: Callable[[], WordIndex] = HybridWordIndex,
    ) -> None:
        """Make a proposer that has seen nothing.

        Args:
            history: all images so far, with their features.
            config: settings; the defaults if None.
            rows: receives the rows of the similarity matrix, by location.
            index: makes the index in which all words are stored and searched.
        """
        self.config = config or HierarchicalPlacesConfig()
        self._images = history.images
        self._open = PlaceSegmentation(self.config.place)
        self._places = PlaceMap(index())
        self._latest = -1
        self._rows = NullMatrixSink() if rows is None else rows
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="rank")

    @property
    def word_count(self) -> int:
        """Number of words in the map so far."""
        return self._places.word_count

    def observe(self, image: ObservedImage) -> list[Proposals]:
        """Add an image, which may end a place, and propose images of the likeliest places."""
        self._latest = image.location
        descriptors = image.features.descriptors[: self.config.word_features]
        self._learn(self._open.add(descriptors), image.location - 1)
        if len(descriptors) < self.config.place.min_features:
            return [Proposals(image.location, image.last_matchable)]  # a nearly blank image cannot be matched
        return [self._match(image, descriptors[: self.config.voting_features])]

    def finish(self) -> list[Proposals]:
        """End the last place; each image has been answered at once."""
        self._learn(self._open.flush(), self._latest)
        return []

    def _learn(self, ended: list[Floats], last: int) -> None:
        """Make the words of a place that has ended at location `last` from its descriptors; nothing if none ended."""
        if ended:
            # A generator of its own for each place: its words do not depend on how many numbers others have drawn.
            rng = np.random.default_rng((self.config.seed, len(self._places)))
            self._places.add(grow_gas(np.concatenate(ended), rng, self.config.gas).nodes, last)

    def _match(self, image: ObservedImage, descriptors: Floats) -> Proposals:
        """Propose images of the places for which the descriptors (N, D) vote."""
        count = self._places.activate_until(image.last_matchable)
        nearest = self._places.nearest_words(descriptors)
        votes = vote_for_places(nearest, self._places, count, self.config.distinct_votes)
        self._record(image.location, votes)
        locations, matches = self._count_matches(image.location, self._sample_images(votes, count))
        order = np.argsort(-matches, kind="stable")
        ranked = [locations[k] for k in order if locations[k] <= image.last_matchable]
        chosen = select_apart(ranked, self.config.max_candidates, self.config.min_separation)
        best = tuple(ranked[k] for k in chosen)
        scores = tuple(votes.neg_log10_probability(self._places.place_of(location)) for location in best)
        return Proposals(image.location, image.last_matchable, best, scores)

    def _count_matches(self, query: int, locations: list[int]) -> tuple[list[int], NDArray[np.int64]]:
        if not locations:
            return [], np.empty(0, np.int64)
        strongest = self._images[query].strongest(self.config.ranking_features).quantized
        half = len(locations) // 2
        other = self._pool.submit(self._rank, strongest, locations[half:])  # the second half in a second thread
        return locations, np.concatenate([self._rank(strongest, locations[:half]), other.result()])

    def _rank(self, strongest: NDArray[np.int8], locations: list[int]) -> NDArray[np.int64]:
        others = self._images.strongest(locations, self.config.ranking_features)
        return count_matches(strongest, *others, self.config.ranking_ratio)

    def _sample_images(self, votes: PlaceVotes, count: int) -> list[int]:
        """Every `image_stride`-th location of the likeliest places and of the places beside the best one."""
        if len(votes.places) == 0:
            return []
        best, stride, beside = int(votes.places[0]), self.config.image_stride, self.config.neighbor_places
        # Near its ends a place and its neighbour look alike.
        near = range(max(best - beside, 0), min(best + beside + 1, count))
        places = dict.fromkeys([*votes.places[: self.config.max_places].tolist(), *near])
        spans = [self._places.images(place) for place in places]
        # From the middle of the first stride on: the ends of a place look like the places beside it.
        return [location for span in spans for location in span[min(stride, len(span)) // 2 :: stride]]

    def _record(self, query: int, votes: PlaceVotes) -> None:
        """Hand the votes of each place to the matrix sink, for all images of the place."""
        spans = self._places.spans(votes.places)
        locations, counts = expand_spans(spans), spans[:, 1] - spans[:, 0] + 1
        values = np.repeat(votes.votes.astype(np.float64), counts)
        self._rows.add(query, locations, values)

    def state(self) -> dict[str, Any]:
        """Everything that changes from image to image, for a checkpoint."""
        return {"open_place": self._open.state(), "places": self._places.state(), "latest": self._latest}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from the state of another proposer of this configuration."""
        self._open.restore(state["open_place"])
        self._places.restore(state["places"])
        self._latest = state["latest"]
