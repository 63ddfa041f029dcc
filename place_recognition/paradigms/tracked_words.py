"""Place recognition by a bag of tracked words: a vocabulary made while driving, votes, and a test of chance.

Tsintotas, Bampis, Gasteratos, 'Probabilistic Appearance-Based Place Recognition Through Bag of Tracked Words',
RA-L 4(2) 2019. What differs from the paper, each for a reason found on real drives:
* Neighbouring images share most of their words, so the location with the most votes is often several images off: the
  one among its neighbours that matches best is taken.
* The search area keeps a way and a number of images away from the query too: where one drives slowly or stands, tracks
  break while the view stays. And not the very longest track counts, but nearly (`FeatureTracks.longest`).
* Each word votes once (`count_votes`).
* Where tracks are short, the best of them become words all the same (`TrackConfig.min_length_frames`).
* Geometry chooses among the best voted places, and decides: in a small map no votes are improbable enough.
* The score adds the evidence of geometry, of this image and of those around it, to that of the votes.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from place_recognition.belief.geometric_verification import VerificationConfig
from place_recognition.belief.hindsight import HindsightConfig, Opinion
from place_recognition.belief.judge import Judge
from place_recognition.belief.proof import Proof, ProofConfig
from place_recognition.belief.temporal_consistency import ConsistencyConfig
from place_recognition.belief.verdicts import Verdicts
from place_recognition.belief.votes import Ballot, count_votes
from place_recognition.image_processing.features import FeatureCache, check_gray
from place_recognition.map.route import ImageHistory, ImageHistoryConfig
from place_recognition.map.tracked_words import FeatureTracks, TrackConfig, WordMap
from place_recognition.map.word_index import WordIndex
from place_recognition.map.word_tree import HybridWordIndex
from place_recognition.recognizer import Belief, NoRows, RowSink


@dataclass(frozen=True)
class TrackedWordsConfig:
    """The paper's numbers, and those of the additions.

    Attributes:
        chance: a location whose votes are likelier than this is no revisit, delta in the paper.
        tracks: how features become words.
        route: what is kept of each image, and which are past.
        proof: how a revisit is proved.
        consistency: which earlier proofs speak for a new one.
        hindsight: what the images around one say for it.
        neighbours: images before and after a voted one among which the best match is sought.
        places: voted places that are looked at; the paper tries the one with the most votes only.
    """

    chance: float = 2e-11
    tracks: TrackConfig = field(default_factory=TrackConfig)
    route: ImageHistoryConfig = field(default_factory=ImageHistoryConfig)
    proof: ProofConfig = field(default_factory=lambda: ProofConfig(verification=VerificationConfig(least_inliers=9)))
    consistency: ConsistencyConfig = field(default_factory=ConsistencyConfig)
    hindsight: HindsightConfig = field(default_factory=HindsightConfig)
    neighbours: int = 6
    places: int = 3

    @classmethod
    def published(cls) -> "TrackedWordsConfig":
        """The paper's numbers (Table II): one place is tried, and 9 inliers are enough."""
        proof = ProofConfig(verification=VerificationConfig(least_inliers=9))
        return cls(neighbours=0, places=1, proof=proof, hindsight=HindsightConfig.none())


class TrackedWords:
    """Recognises places by words that it learns as it goes (a PlaceRecognizer).

    Answers some images late (`Verdicts`).
    """

    def __init__(
        self,
        features: FeatureCache,
        config: TrackedWordsConfig | None = None,
        rows: RowSink | None = None,
        index: Callable[[], WordIndex] = HybridWordIndex,
    ) -> None:
        self.config = config or TrackedWordsConfig()
        self._features = features
        self._tracks = FeatureTracks(self.config.tracks)
        self._route = ImageHistory(self.config.route)
        self._words = WordMap(index())
        self._judge = Judge(self._route.images, self.config.proof, self.config.consistency)
        self._verdicts = Verdicts(self._route, self.config.hindsight)
        self._rows = NoRows() if rows is None else rows

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
        check_gray(image)
        features = self._features.get(image_id, image)
        self._route.add(image_id, features, travelled)
        self._words.add(self._tracks.advance(image, features))
        return self._verdicts.add(self._opinion())

    def finish(self) -> list[Belief]:
        """Answer for the last images."""
        return self._verdicts.finish()

    def _opinion(self) -> Opinion:
        """The opinion about the latest image."""
        horizon = self._past()
        self._words.activate_until(horizon)
        ballot = count_votes(self._words.lookup(self._tracks.descriptors), self._words)
        query = int(self._route.ids[-1])
        self._rows.add(query, self._route.ids[ballot.locations], ballot.votes.astype(np.float64))
        return self._verified(query, ballot, horizon)

    def _past(self) -> int:
        """The latest location of which no point is still being followed and that is far enough behind.

        Where no way is measured, only what is in view can tell a slow drive or a stop from one that goes on.
        """
        behind = (
            self._route.last_outside_exclusion() if self._route.is_distance_measured else self._route.last_matchable()
        )
        return min(behind, self._route.latest - 2 * self._tracks.longest_frames)

    def _verified(self, query: int, ballot: Ballot, horizon: int) -> Opinion:
        """What votes and geometry say of the best neighbours of voted locations."""
        voted = ballot.leaders(self.config.places, self.config.neighbours, math.log(self.config.chance))
        proofs = self._judge.judge(self._route.latest, self._around(voted, horizon), horizon)
        return Opinion.of(query, proofs, lambda proof: self._belief(query, proof, ballot))

    def _belief(self, query: int, proof: Proof, ballot: Ballot) -> Belief:
        return Belief(
            query=query,
            match=int(self._route.ids[proof.location]),
            score=ballot.improbability(proof.location, self.config.neighbours) + proof.evidence,
            accepted=proof.verified,
            inliers=proof.inliers,
            verified=proof.verified,
            pixels=proof.pixels,
        )

    def _around(self, voted: list[int], horizon: int) -> list[int]:
        """The voted locations and those beside them that may be matched, the nearest to a voted one first."""
        steps = sorted(range(-self.config.neighbours, self.config.neighbours + 1), key=abs)
        near = dict.fromkeys(location + step for step in steps for location in voted)
        return [location for location in near if 0 <= location <= horizon]

    def state(self) -> dict[str, Any]:
        """Everything that changes from image to image, for a checkpoint."""
        return {
            "tracks": self._tracks.state(),
            "history": self._route.state(),
            "words": self._words.state(),
            "consistency": self._judge.state(),
            "decision": self._verdicts.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from the state of another recogniser of this configuration."""
        self._tracks.restore(state["tracks"])
        self._route.restore(state["history"])
        self._words.restore(state["words"])
        self._judge.restore(state["consistency"])
        self._verdicts.restore(state["decision"])
