"""Place recognition by places with words of their own: first the place is found, then the image in it.

Tsintotas, Bampis, Gasteratos, 'Assigning Visual Words to Places for Loop Closure Detection', ICRA 2018; section 4.4.3
of the chapter.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from place_recognition.belief.geometric_verification import VerificationConfig
from place_recognition.belief.judge import Judge
from place_recognition.belief.proof import ProofConfig
from place_recognition.belief.temporal_consistency import ConsistencyConfig
from place_recognition.belief.votes import log_binomial
from place_recognition.image_processing.features import SharedFeatures
from place_recognition.image_processing.surf import check_grey
from place_recognition.map.growing_neural_gas import GasConfig, grow_gas
from place_recognition.map.places import PlaceConfig, PlaceFormation, PlaceMap
from place_recognition.map.route import Route, RouteConfig
from place_recognition.map.word_index import ExactWordIndex, WordIndex, nearest_words
from place_recognition.recognizer import Belief, NoRows, RowSink

Floats = NDArray[np.float32]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class HierarchicalPlacesConfig:
    chance: float = 1e-12
    features: int = 300
    asked: int = 150
    searched: int = 100
    places: int = 3
    proposed: int = 8
    sure_inliers: int = 60
    seed: int = 0
    once: bool = True
    place: PlaceConfig = field(default_factory=PlaceConfig)
    gas: GasConfig = field(default_factory=GasConfig)
    route: RouteConfig = field(default_factory=RouteConfig)
    proof: ProofConfig = field(default_factory=lambda: ProofConfig(verification=VerificationConfig(least_inliers=12)))
    consistency: ConsistencyConfig = field(default_factory=ConsistencyConfig)


@dataclass(frozen=True)
class PlaceBallot:
    """What one image's descriptors voted for.

    Attributes:
        places: (P,) int64, places with more votes than expected, the least likely first.
        votes: (P,) int64, votes of each.
        log_density: (P,) natural logarithm of the binomial probability of just these votes.
    """

    places: Indices
    votes: Indices
    log_density: NDArray[np.float64]

    def improbability(self, place: int) -> float:
        """-log10 of the probability of the votes of a place; 0 for one that has not more than expected."""
        found = np.flatnonzero(self.places == place)
        return -float(self.log_density[found[0]]) / math.log(10) if len(found) else 0.0


class HierarchicalPlaces:
    """Recognises places by the words that each has of its own (a PlaceRecognizer). Answers each image at once."""

    def __init__(
        self,
        features: SharedFeatures,
        config: HierarchicalPlacesConfig | None = None,
        rows: RowSink | None = None,
        index: Callable[[], WordIndex] = ExactWordIndex,
    ) -> None:
        self.config = config or HierarchicalPlacesConfig()
        self._features = features
        self._route = Route(self.config.route)
        self._open = PlaceFormation(self.config.place)
        self._places = PlaceMap(index())
        self._judge = Judge(self._route.images, self.config.proof, self.config.consistency)
        self._rows = NoRows() if rows is None else rows

    @property
    def word_count(self) -> int:
        """Words in the map so far."""
        return self._places.word_count

    def observe(self, image_id: int, image: NDArray[np.uint8], travelled: float) -> list[Belief]:
        """Answer for this image and add it to the map.

        Args:
            image_id: greater than the one before.
            image: (H, W) uint8, grey.
            travelled: way driven so far, metres; NaN, or always the same, where it is not measured.
        """
        check_grey(image)
        features = self._features.of(image_id, image)
        self._route.add(image_id, features, travelled)
        descriptors = features.descriptors[: self.config.features]
        self._learn(self._open.add(descriptors), self._route.latest - 1)
        return [self._believe(descriptors)]

    def finish(self) -> list[Belief]:
        """End the last place; nothing is left unanswered."""
        self._learn(self._open.flush(), self._route.latest)
        return []

    def _learn(self, ended: list[Floats], last: int) -> None:
        """Find the words of a place that has ended at a location."""
        if ended:
            rng = np.random.default_rng((self.config.seed, len(self._places)))
            self._places.add(grow_gas(np.concatenate(ended), rng, self.config.gas).nodes, last)

    def _believe(self, descriptors: Floats) -> Belief:
        """The belief about the latest image."""
        horizon = self._route.horizon()
        ballot = self._vote(descriptors, horizon)
        self._show(ballot)
        judgement = self._judge.judge(self._route.latest, self._propose(ballot, descriptors), horizon)
        query = int(self._route.ids[-1])
        if judgement is None:
            return Belief(query, None, 0.0, accepted=False)
        proof = judgement.proof
        improbable = ballot.improbability(int(self._places.place_of(proof.location)))
        sure = improbable > -math.log10(self.config.chance) or proof.inliers >= self.config.sure_inliers
        return Belief(
            query=query,
            match=int(self._route.ids[proof.location]),
            score=improbable + judgement.evidence,
            accepted=proof.verified and sure,
            inliers=proof.inliers,
            verified=proof.verified,
        )

    def _vote(self, descriptors: Floats, horizon: int) -> PlaceBallot:
        count = self._places.until(horizon)
        words = np.empty(0, np.int64)
        if len(descriptors) >= self.config.place.least_features:
            words = self._places.nearest_words(descriptors[: self.config.asked])
        words = words[words < self._places.words_of_first(count)]
        if self.config.once:
            words = np.unique(words)
        places, votes = np.unique(self._places.owners(words), return_counts=True)
        share = self._places.word_counts(places) / max(self._places.words_of_first(count), 1)
        above = votes > len(words) * share
        places, votes, share = places[above], votes[above], share[above]
        density = log_binomial(votes, len(words), share)
        order = np.argsort(density, kind="stable")
        return PlaceBallot(places[order], votes[order], density[order])

    def _propose(self, ballot: PlaceBallot, descriptors: Floats) -> list[int]:
        """Locations of the images that look most like the query, in the likeliest places."""
        if len(ballot.places) == 0:
            return []
        best = int(ballot.places[0])
        beside = [p for p in (best - 1, best + 1) if 0 <= p < self._places.until(self._route.horizon())]
        places = dict.fromkeys([*ballot.places[: self.config.places].tolist(), *beside])
        locations = [k for p in places for k in self._places.images(p)]
        stored = [self._route.images[k].strongest(self.config.searched).descriptors for k in locations]
        image_of = np.repeat(np.arange(len(stored)), [len(d) for d in stored])
        nearest = nearest_words(descriptors[: self.config.asked], np.concatenate(stored))
        votes = np.bincount(image_of[nearest], minlength=len(stored))
        order = np.argsort(-votes, kind="stable")[: self.config.proposed]
        return [locations[k] for k in order]

    def _show(self, ballot: PlaceBallot) -> None:
        """Show the votes of each place beside all its images."""
        for place, votes in zip(ballot.places, ballot.votes, strict=True):
            ids = self._route.ids[self._places.images(int(place))]
            self._rows.add(int(self._route.ids[-1]), ids, np.full(len(ids), float(votes)))
