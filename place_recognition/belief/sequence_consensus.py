"""Delayed decision by sequence consensus: a match is accepted if the matches around it lie on one line with it.

In the plane of query location and match location a revisit is a line, whose slope is the ratio of the two speeds, as in
SeqSLAM (Milford and Wyeth, ICRA 2012). So the decision about an image waits for some images, and the evidence of the
images before and after it is added to its own where their matches lie on a line through its match:

    match location                 . * .
        ^                      *            * match on the line: supports the image in the middle (o)
        |                  o                x surer match off all lines: contradicts it
        |              *
        |          *         x
        +-------------------------> query location

Chance matches lie on no line; matches of a street that is seen from afar lie on one, but before or after it only.
How the support is computed step by step: docs/math.md. How the numbers were chosen, with figures:
docs/decisions/sequence_consensus.md.

`DelayedDecision`, which every paradigm ends with, joins the consensus with the `GapFiller`: candidate beliefs go in,
final beliefs come out some images later, in order.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from place_recognition.belief.candidate_verification import VerificationResult
from place_recognition.belief.temporal_consistency import GapFiller
from place_recognition.map.image_history import ImageHistory
from place_recognition.recognizer import Belief

Array = NDArray[np.float64]
Steps = NDArray[np.int64]

# Ratios of the two speeds that are tried, 0.84 to 1.19; tolerance and drift let somewhat other ones pass as well.
_SPEED_RATIOS = 2.0 ** np.arange(-0.25, 0.26, 0.125)
_SLOPES = np.concatenate([_SPEED_RATIOS, -_SPEED_RATIOS])  # negative: the place is driven in the opposite direction

# Images by which the tolerance grows for each image between the two: speeds change along the path.
_TOLERANCE_GROWTH = 0.1

# Support from one side only counts up to this times the image's own evidence: where a revisit begins or ends, the
# other side has nothing to show. 4 and 8 were tried: 8 accepts images before and after the revisit as well.
_MAX_ONE_SIDED_SUPPORT = 6.0

# Support counts up to _MAX_SUPPORT_FROM_AFAR times the evidence of the image and of those within _NEAR_IMAGES of it:
# evidence far away on both sides does not fill a gap. Half and twice these numbers give R@P100 within 0.01.
_NEAR_IMAGES = 5
_MAX_SUPPORT_FROM_AFAR = 10.0

# A line supports up to (mean evidence of its _BEST_IMAGES best images)^2 / _WEAK_EVIDENCE. A true line has some images
# of much evidence; repeated kerbs and cars give many images of 5 to 31 each, which add up to 300.
_BEST_IMAGES = 3
_WEAK_EVIDENCE = 5.0

# A match contradicts another one for certain if its evidence is this many times larger and if it lies off all lines
# through the other by more than this number of images.
_CONTRADICTION_RATIO = 2.0
_CONTRADICTION_DISTANCE_IMAGES = 6.0


@dataclass(frozen=True)
class SequenceConsensusConfig:
    """Settings of the delayed decision.

    Attributes:
        window: number of images before and after an image that support or contradict it. The answer is delayed by this
            number of images. Matches of one image closer together than this are reduced to the best one.
        max_image_evidence: cap of the evidence of each supporting image, powers of ten: a single one must not decide.
        tolerance_images: images by which a match may lie off the line; one that lies off by more than twice as many
            contradicts.
        min_total_evidence: evidence of the image and its support from which a match is accepted, powers of ten.
    """

    window: int = 15
    max_image_evidence: float = 20.0
    tolerance_images: float = 2.0
    min_total_evidence: float = 100.0

    @classmethod
    def disabled(cls) -> "SequenceConsensusConfig":
        """Return settings that decide each image at once and alone, as the papers do."""
        return cls(window=0, min_total_evidence=0.0)


@dataclass(frozen=True)
class CandidateBeliefs:
    """Beliefs of a paradigm about one image, one for each verified candidate, before the next images are known.

    Attributes:
        beliefs: one for each candidate, accepted where the paradigm does not reject it; a single one without match if
            there is no candidate.
        results: geometric verification of each candidate, in the same order; empty without candidates.
    """

    beliefs: tuple[Belief, ...]
    results: tuple[VerificationResult, ...] = ()

    @classmethod
    def without_match(cls, query: int) -> "CandidateBeliefs":
        """Return the candidate beliefs of the image with this id if it has no candidate."""
        return cls((Belief(query, None, 0.0, accepted=False),))

    @classmethod
    def from_results(
        cls, query: int, results: tuple[VerificationResult, ...], make_belief: Callable[[VerificationResult], Belief]
    ) -> "CandidateBeliefs":
        """Return the candidate beliefs of the image with this id, made from each verification result."""
        return cls(tuple(map(make_belief, results)), results) if results else cls.without_match(query)

    def state(self) -> dict[str, Any]:
        """Beliefs and results as plain values and arrays, for a checkpoint."""
        return {
            "beliefs": [dict(vars(belief)) for belief in self.beliefs],
            "results": [dict(vars(result)) for result in self.results],
        }

    @classmethod
    def from_state(cls, state: dict[str, Any]) -> "CandidateBeliefs":
        """Return the candidate beliefs of a state."""
        beliefs = tuple(Belief(**belief) for belief in state["beliefs"])
        return cls(beliefs, tuple(VerificationResult(**result) for result in state["results"]))


class SequenceConsensus:
    """Takes candidate beliefs in the order of queries and returns one belief for each, `window` images later."""

    def __init__(self, config: SequenceConsensusConfig | None = None) -> None:
        self.config = config or SequenceConsensusConfig()
        images = 2 * self.config.window + 1
        self._candidates: deque[CandidateBeliefs] = deque(maxlen=images)
        # Of each image, the results with which it supports or contradicts others.
        self._witnesses: deque[list[VerificationResult]] = deque(maxlen=images)
        self._undecided = 0  # number of the latest images that have no belief yet

    def add(self, candidates: CandidateBeliefs) -> list[Belief]:
        """Add the candidates of the next query and return the belief that is decided now, if there is one."""
        self._candidates.append(candidates)
        self._witnesses.append(_best_apart(candidates.results, self.config.window))
        self._undecided += 1
        return [self._decide()] if self._undecided > self.config.window else []

    def finish(self) -> list[Belief]:
        """Return the beliefs about the last images, which have fewer images after them."""
        return [self._decide() for _ in range(self._undecided)]

    def _decide(self) -> Belief:
        """Decide about the image that has waited longest."""
        center = len(self._candidates) - self._undecided
        candidates = self._candidates[center]
        others = [w for k, w in enumerate(self._witnesses) if k != center and abs(k - center) <= self.config.window]
        witnesses = [result for other in others for result in other]
        self._undecided -= 1
        if not candidates.results:
            return candidates.beliefs[0]
        support = self._support(candidates.results, witnesses)
        totals = np.array([result.evidence for result in candidates.results]) + support
        best = int(np.argmax(totals))
        belief = candidates.beliefs[best]
        accepted = belief.accepted and bool(totals[best] >= self.config.min_total_evidence)
        return replace(belief, score=belief.score + float(support[best]), accepted=accepted)

    # Shapes below: P candidates of the image, S slopes, N results of the images around it ("witnesses").

    def _support(self, candidates: tuple[VerificationResult, ...], witnesses: list[VerificationResult]) -> Array:
        """Support (P,) of each candidate by the witnesses, in the order of queries; negative where contradicted."""
        own = np.array([candidate.evidence for candidate in candidates])
        if not witnesses:
            return np.zeros_like(own)
        evidence = np.array([witness.evidence for witness in witnesses])
        steps = np.array([witness.query - candidates[0].query for witness in witnesses])
        moves = np.array([[w.location - candidate.location for w in witnesses] for candidate in candidates])
        # (P, S, N) distance in match location from the line of each slope through each candidate
        distance = np.abs(moves[:, None] - _SLOPES[:, None] * steps) - _TOLERANCE_GROWTH * np.abs(steps)
        contradiction = self._contradiction(own, evidence, steps, distance.min(axis=1))
        # A match far away is another place and no contradiction of this line: only near ones count as off it.
        off_line = (distance > 2 * self.config.tolerance_images) & (np.abs(moves) <= self.config.window)[:, None]
        capped = np.minimum(evidence, self.config.max_image_evidence)
        on_line = distance <= self.config.tolerance_images
        line_cap = _mean_best_evidence(own, np.where(on_line, evidence, 0.0)) ** 2 / _WEAK_EVIDENCE
        support = _line_support(own, steps, np.where(on_line, capped, 0.0), np.where(off_line, capped, 0.0))
        best: Array = np.minimum(support, line_cap).max(axis=1)
        return best - contradiction

    def _contradiction(self, own: Array, evidence: Array, steps: Steps, distance: Array) -> Array:
        """Evidence (P,) against each candidate: of images whose best match is surer and off every line.

        Args:
            own: (P,) evidence of each candidate.
            evidence: (N,) evidence of each witness.
            steps: (N,) query of each witness minus that of the candidates, rising.
            distance: (P, N) smallest distance of each witness from any line through each candidate.
        """
        firsts = np.flatnonzero(np.diff(steps, prepend=steps[0] - 1))
        best_of_image = np.repeat(np.maximum.reduceat(evidence, firsts), np.diff(firsts, append=len(steps)))
        required = np.maximum(_CONTRADICTION_RATIO * own, self.config.max_image_evidence)
        is_surer = (evidence == best_of_image) & (evidence >= required[:, None])
        is_off = distance > _CONTRADICTION_DISTANCE_IMAGES
        against = np.where(is_surer & is_off, self.config.max_image_evidence, 0.0)
        return _sum_best_per_image(against, steps, np.ones(len(steps), bool))

    def state(self) -> dict[str, Any]:
        """The candidate beliefs of the window, for a checkpoint."""
        return {"candidates": [candidates.state() for candidates in self._candidates], "num_undecided": self._undecided}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        for candidates in map(CandidateBeliefs.from_state, state["candidates"]):
            self._candidates.append(candidates)
            self._witnesses.append(_best_apart(candidates.results, self.config.window))
        self._undecided = state["num_undecided"]


class DelayedDecision:
    """One belief for each query, in order: first the sequence consensus decides, then short gaps are filled."""

    def __init__(self, history: ImageHistory, config: SequenceConsensusConfig) -> None:
        self._consensus, self._gap_filler = SequenceConsensus(config), GapFiller(history)

    def add(self, candidates: CandidateBeliefs) -> list[Belief]:
        """Add the candidates of the next query and return the beliefs that are decided now."""
        return self._gap_filler.add(self._consensus.add(candidates))

    def finish(self) -> list[Belief]:
        """Return the beliefs about the last images."""
        return self._gap_filler.add(self._consensus.finish()) + self._gap_filler.finish()

    def state(self) -> dict[str, Any]:
        """Everything that waits for later images, for a checkpoint."""
        return {"consensus": self._consensus.state(), "gaps": self._gap_filler.state()}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._consensus.restore(state["consensus"])
        self._gap_filler.restore(state["gaps"])


def _mean_best_evidence(own: Array, on_line: Array) -> Array:
    """Mean evidence (P, S) of the _BEST_IMAGES best results on each line, the candidate included.

    Args:
        own: (P,) evidence of each candidate.
        on_line: (P, S, N) evidence of each witness on each line, 0 where it is off.
    """
    with_own = np.concatenate([np.broadcast_to(own[:, None, None], (*on_line.shape[:2], 1)), on_line], axis=2)
    best = min(_BEST_IMAGES, with_own.shape[2])
    return np.sort(with_own, axis=2)[..., -best:].sum(axis=2) / _BEST_IMAGES


def _line_support(own: Array, steps: Steps, on_line: Array, off_line: Array) -> Array:
    """Support (P, S) of each candidate on each line, by the images before and after it.

    Both sides count as far as they agree. The rest of the stronger side counts less what the other side has against
    it, within the two caps at the top of this file.

    Args:
        own: (P,) evidence of each candidate.
        steps: (N,) query of each witness minus that of the candidates, rising.
        on_line: (P, S, N) evidence of each witness on each line, 0 where it is off.
        off_line: (P, S, N) evidence of each witness off each line, 0 where it is on it or far away.
    """
    before, after = (_sum_best_per_image(on_line, steps, side) for side in (steps < 0, steps > 0))
    against_before = _sum_best_per_image(off_line, steps, steps > 0)
    against_after = _sum_best_per_image(off_line, steps, steps < 0)
    against = np.where(before > after, against_before, against_after)
    one_sided = np.clip(np.abs(before - after) - against, 0.0, _MAX_ONE_SIDED_SUPPORT * own[:, None])
    near = _sum_best_per_image(on_line, steps, np.abs(steps) <= _NEAR_IMAGES)
    return np.minimum(2 * np.minimum(before, after) + one_sided, _MAX_SUPPORT_FROM_AFAR * (own[:, None] + near))


def _best_apart(results: tuple[VerificationResult, ...], min_separation: int) -> list[VerificationResult]:
    """The results of one image, best first, without those within `min_separation` locations of a better one."""
    chosen: list[VerificationResult] = []
    for result in sorted(results, key=lambda result: -result.evidence):
        if all(abs(result.location - other.location) > min_separation for other in chosen):
            chosen.append(result)
    return chosen


def _sum_best_per_image(evidence: Array, steps: Steps, selected: NDArray[np.bool_]) -> Array:
    """Sum over the selected images (...,): each image counts with the largest evidence of its results.

    Args:
        evidence: (..., N) evidence of each result.
        steps: (N,) step of the image of each result, rising.
        selected: (N,) mask of the results of the selected images.
    """
    if not selected.any():
        return np.zeros(evidence.shape[:-1])
    firsts = np.flatnonzero(np.diff(steps[selected], prepend=steps[selected][0] - 1))
    total: Array = np.maximum.reduceat(evidence[..., selected], firsts, axis=-1).sum(axis=-1)
    return total
