"""Place recognition by a bag of tracked words: a vocabulary learnt online, votes, and a binomial test.

Tsintotas, Bampis, Gasteratos, 'Probabilistic Appearance-Based Place Recognition Through Bag of Tracked Words',
RA-L 4(2) 2019. Deviations of the default from the paper (reasons: docs/decisions/tracked_words.md):
* Several locations are proposed, and the least likely votes come first, not the most votes.
* Each word votes once (`count_votes`).
* Where tracks are short, the best of them become words too (`TrackConfig`).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from place_recognition.belief.voting import Votes, count_votes
from place_recognition.recognizer import (
    MAX_STAGE_CANDIDATES,
    MatrixSink,
    NullMatrixSink,
    ObservedImage,
    Proposals,
    select_apart,
)
from place_recognition.vocabulary.word_tracking import FeatureTracks, TrackConfig, WordMap
from place_recognition.vocabulary.word_tree import HybridWordIndex, WordIndex


@dataclass(frozen=True)
class TrackedWordsConfig:
    """Settings of the paradigm: the paper's numbers and those of the deviations.

    Attributes:
        tracks: how tracked features become words.
        max_places: number of locations that are proposed; the paper's 1.
        min_separation: smallest number of images between any two of them.
        ranking: "probability" or "votes", by which the proposed locations are sorted; the paper takes the most votes.
        distinct_votes: whether a word votes once, however often it is hit; in the paper it votes as often.
        exclusion_track_lengths: lengths of the longest track by which a match is older than the query, besides the
            present view: the paper's 2.
    """

    tracks: TrackConfig = field(default_factory=TrackConfig)
    max_places: int = MAX_STAGE_CANDIDATES
    min_separation: int = 4
    ranking: str = "probability"
    distinct_votes: bool = True
    exclusion_track_lengths: int = 0


class TrackedWords:
    """Proposes places by visual words that it learns online from tracked features (a Proposer).

    The score is -log10 of the probability of a location's votes by chance.
    """

    def __init__(
        self,
        config: TrackedWordsConfig | None = None,
        rows: MatrixSink | None = None,
        index: Callable[[], WordIndex] = HybridWordIndex,
    ) -> None:
        """Make a proposer that has seen nothing.

        Args:
            config: settings; the defaults if None.
            rows: receives the rows of the similarity matrix, by location.
            index: makes the index in which all words are stored and searched.
        """
        self.config = config or TrackedWordsConfig()
        self._tracks = FeatureTracks(self.config.tracks)
        self._words = WordMap(index())
        self._reference_end = 0  # number of images of the reference recording, which are past at any track length
        self._rows = NullMatrixSink() if rows is None else rows

    @property
    def word_count(self) -> int:
        """Number of words in the map so far."""
        return len(self._words)

    def observe(self, image: ObservedImage) -> list[Proposals]:
        """Add an image, whose features may become words later, and propose locations for it."""
        self._words.add(self._tracks.advance(image.pixels, image.features))
        by_tracks = image.location - self.config.exclusion_track_lengths * self._tracks.max_length_frames
        if self._reference_end:  # tracks say nothing about images of another recording
            by_tracks = max(by_tracks, self._reference_end - 1)
        last_matchable = min(image.last_matchable, by_tracks)
        self._words.activate_until(last_matchable)  # words of later images are not hit yet
        votes = count_votes(self._words.lookup(self._tracks.descriptors), self._words, self.config.distinct_votes)
        self._rows.add(image.location, votes.locations, votes.votes.astype(np.float64))
        return [self._propose(image.location, last_matchable, votes)]

    def _propose(self, query: int, last_matchable: int, votes: Votes) -> Proposals:
        # An active word may have been seen at a later location too, where the present view has grown since.
        above = np.flatnonzero((votes.votes > votes.expected) & (votes.locations <= last_matchable))
        allowed = above[~self._words.is_forgotten(votes.locations[above])]
        key = votes.log_density[allowed] if self.config.ranking == "probability" else -votes.votes[allowed]
        order = allowed[np.argsort(key, kind="stable")]
        locations = votes.locations[order].tolist()
        chosen = select_apart(locations, self.config.max_places, self.config.min_separation)
        scores = -votes.log_density[order[chosen]] / math.log(10)
        return Proposals(query, last_matchable, tuple(locations[k] for k in chosen), tuple(scores.tolist()))

    def finish(self) -> list[Proposals]:
        """Return nothing: each image is answered at once."""
        return []

    def forget(self, location: int) -> None:
        """Leave the image at a location out of the map (a ForgetfulProposer)."""
        self._words.forget(location)

    def end_reference(self) -> None:
        """Make words of the tracks that go on to the last image, and end all tracks (a ReferenceProposer)."""
        self._words.add(self._tracks.end())
        self._reference_end = self._tracks.num_images

    def state(self) -> dict[str, Any]:
        """Everything that changes from image to image, for a checkpoint."""
        return {"tracks": self._tracks.state(), "words": self._words.state()}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from the state of another proposer of this configuration."""
        self._tracks.restore(state["tracks"])
        self._words.restore(state["words"])
