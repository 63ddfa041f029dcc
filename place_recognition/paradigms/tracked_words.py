"""Place recognition by a bag of tracked words: a vocabulary made while driving, votes, and a test of chance.

Tsintotas, Bampis, Gasteratos, 'Probabilistic Appearance-Based Place Recognition Through Bag of Tracked Words',
RA-L 4(2) 2019. What differs from the paper, each for a reason found on real drives:
* Neighbouring images share most of their words, so the location with the most votes is often several images off: the
  one among its neighbours that matches best is taken.
* The search area keeps a way and a number of images away from the query too: where one drives slowly or stands, tracks
  break while the view stays. And not the very longest track counts, but nearly (`FeatureTracks.longest`).
* Each word votes once (`count_votes`).
* Where tracks are short, the best of them become words all the same (`TrackConfig.least_length`).
* In a small map nothing is improbable enough: many inliers make up for it (`sure_inliers`).
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from place_recognition.belief.geometric_verification import VerificationConfig, epipolar_inliers
from place_recognition.belief.matching import mutual_matches
from place_recognition.belief.votes import Ballot, count_votes, nearest_words
from place_recognition.image_processing.features import SharedFeatures
from place_recognition.image_processing.surf import check_grey
from place_recognition.map.growing import GrowingArray
from place_recognition.map.image_store import ImageStore
from place_recognition.map.tracked_words import FeatureTracks, TrackConfig, WordMap, count_covering
from place_recognition.recognizer import Belief

NOTHING = np.empty(0, np.int64)


@dataclass(frozen=True)
class TrackedWordsConfig:
    """The paper's numbers, and those of the two additions.

    Attributes:
        chance: a location whose votes are likelier than this is no revisit, delta in the paper.
        tracks: how features become words.
        verification: what proves a revisit.
        ratio: nearest to second nearest descriptor distance of a match between two images.
        neighbours: images before and after the voted one among which the best match is sought.
        compared: strongest features of each image that this search compares.
        stored: strongest features of each image that are kept.
        least_way: way between a query and its match, metres; ignored while no way has been measured.
        sure_inliers: with so many the votes may be likelier than `chance`: in a map of a hundred words even a perfect
            revisit is not improbable enough, while images of different places share half as many at the very most.
        least_gap: images between a query and its match.
    """

    chance: float = 2e-11
    tracks: TrackConfig = field(default_factory=TrackConfig)
    verification: VerificationConfig = field(default_factory=VerificationConfig)
    ratio: float = 0.8
    neighbours: int = 6
    compared: int = 200
    stored: int = 500
    least_way: float = 20.0
    sure_inliers: int = 60
    least_gap: int = 10


class TrackedWords:
    """Recognises places by words that it learns as it goes (a PlaceRecognizer). Answers each image at once."""

    def __init__(self, features: SharedFeatures, config: TrackedWordsConfig | None = None) -> None:
        self.config = config or TrackedWordsConfig()
        self._features = features
        self._tracks = FeatureTracks(self.config.tracks)
        self._images = ImageStore(self.config.stored)
        self._words = WordMap()
        self._ids: list[int] = []
        self._ways: GrowingArray[np.float64] = GrowingArray(np.float64)
        self._voted: list[NDArray[np.int64]] = []

    @property
    def word_count(self) -> int:
        """Words in the map so far."""
        return len(self._words)

    def observe(self, image_id: int, image: NDArray[np.uint8], travelled: float) -> list[Belief]:
        """Answer for this image and add it to the map.

        Args:
            image_id: greater than the one before.
            image: (H, W) uint8, grey. After a change of size all tracks start anew.
            travelled: way driven so far, metres; NaN, or always the same, where it is not measured.
        """
        check_grey(image)
        if self._ids and image_id <= self._ids[-1]:
            raise ValueError(f"expected an image id greater than {self._ids[-1]}, got {image_id}")
        features = self._features.of(image_id, image)
        self._words.add(self._tracks.advance(image, features))
        self._images.add(features)
        self._ids.append(image_id)
        self._ways.extend(np.array([travelled]))
        return [self._believe()]

    def finish(self) -> list[Belief]:
        """Nothing is left unanswered."""
        return []

    def similarity_row(self, image_id: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Ids (L,) of the images that got votes from an image that was seen, and their votes (L,); both int64."""
        location = int(np.searchsorted(self._ids, image_id))
        if location == len(self._ids) or self._ids[location] != image_id:
            raise ValueError(f"expected the id of an image that was observed, got {image_id}")
        words, hit = self._words.until(location), self._voted[location]
        votes = count_covering(words.first[hit], words.last[hit], location)
        voted = np.flatnonzero(votes)
        return np.array(self._ids)[voted], votes[voted]

    def _believe(self) -> Belief:
        """The belief about the latest image."""
        horizon = self._horizon()
        words = self._words.until(horizon)
        hit = np.unique(nearest_words(self._tracks.descriptors, words.descriptors)) if len(words) else NOTHING
        self._voted.append(hit)
        ballot = count_votes(hit, words, horizon + 1)
        voted = ballot.best(math.log(self.config.chance))
        if voted is None:
            return Belief(self._ids[-1], None, 0.0, accepted=False)
        return self._verified(voted, ballot, horizon)

    def _horizon(self) -> int:
        """The latest location that may be matched with the latest image; -1 or less for none.

        Twice the longest track (the paper), a number of images, and a way if any has been measured.
        """
        latest, ways = len(self._ids) - 1, self._ways.rows
        horizon = latest - max(2 * self._tracks.longest, self.config.least_gap)
        if np.isfinite(ways[-1]) and ways[-1] != ways[0]:
            horizon = min(horizon, int(np.searchsorted(ways, ways[-1] - self.config.least_way, side="right")) - 1)
        return max(horizon, -1)

    def _verified(self, voted: int, ballot: Ballot, horizon: int) -> Belief:
        """The belief in the best neighbour of the voted location, proved by geometry or not."""
        location = self._refine(voted, horizon)
        query, match = self._images[len(self._ids) - 1], self._images[location]
        pairs = mutual_matches(query.descriptors, match.descriptors, self.config.ratio)
        agree = epipolar_inliers(query.pixels[pairs[:, 0]], match.pixels[pairs[:, 1]], self.config.verification)
        inliers = 0 if agree is None else int(np.count_nonzero(agree))
        unlikely = bool(ballot.log_density[voted] < math.log(self.config.chance))
        return Belief(
            query=self._ids[-1],
            match=self._ids[location],
            score=float(-ballot.log_density[voted] / math.log(10)),
            accepted=agree is not None and (unlikely or inliers >= self.config.sure_inliers),
            inliers=inliers,
            verified=agree is not None,
        )

    def _refine(self, voted: int, horizon: int) -> int:
        """Location near the voted one with the most matches to the latest image; of equal ones the nearest."""
        query = self._images[len(self._ids) - 1].strongest(self.config.compared).descriptors
        reach = self.config.neighbours
        near = range(max(voted - reach, 0), min(voted + reach, horizon) + 1)
        counts = [len(mutual_matches(query, self._compared(location), self.config.ratio)) for location in near]
        return max(near, key=lambda location: (counts[location - near.start], -abs(location - voted)))

    def _compared(self, location: int) -> NDArray[np.float32]:
        return self._images[location].strongest(self.config.compared).descriptors
