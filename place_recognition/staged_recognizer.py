"""The recogniser of every paradigm: proposals, then geometric verification, then a decision over the images around.

image -> features -> [paradigm: its map and its own score] -> proposals
-> [geometry: matches that agree with one epipolar geometry] -> evidence
-> [decision: a probability over places, or the thresholds of a published method] -> belief
"""

from collections import deque
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.local_features import FeatureCache
from place_recognition.image_processing.onnx_network import check_image, convert_channels
from place_recognition.map.image_history import ImageHistory
from place_recognition.recognizer import (
    Belief,
    ForgetfulProposer,
    MatrixSink,
    NullMatrixSink,
    ObservedImage,
    Proposals,
    Proposer,
    ReferenceProposer,
)
from place_recognition.verification.candidate_verification import (
    CandidateVerificationConfig,
    VerificationResult,
    verify_candidates,
)
from place_recognition.verification.present_view import FixedPast

# The paradigms of sequences propose for many images at once. Their verification is spread over the images that follow:
# one for each, so that all images take the same time, and two while more than these wait.
_MAX_WAITING = 6


class ExclusionWindow(Protocol):
    """Which of the latest images belong to the present: a PresentView or a FixedWindow."""

    def advance(self) -> int:
        """Follow the history to its newest image; return the latest location that it may be matched with, or -1."""
        ...

    def state(self) -> dict[str, Any]:
        """Everything that changes from image to image, for a checkpoint."""
        ...

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        ...


class Decision(Protocol):
    """Turns the verified candidates of successive queries into one belief for each, in order, possibly later."""

    def add(self, proposals: Proposals, results: tuple[VerificationResult, ...]) -> list[Belief]:
        """Add the candidates of the next query and return the beliefs that are ready now."""
        ...

    def finish(self) -> list[Belief]:
        """Return the beliefs about the last queries."""
        ...

    def end_reference(self) -> None:
        """Forget what connects successive images: the next one belongs to another recording."""
        ...

    def state(self) -> Any:
        """Everything that waits for later images, for a checkpoint."""
        ...

    def restore(self, state: Any) -> None:
        """Continue from a state."""
        ...


class StagedRecognizer:
    """Recognises places in stages (a PlaceRecognizer): each can be seen, measured and replaced by itself."""

    def __init__(
        self,
        features: FeatureCache,
        history: ImageHistory,
        view: ExclusionWindow,
        proposer: Proposer,
        decision: Decision,
        verification: CandidateVerificationConfig,
    ) -> None:
        self._features, self._history = features, history
        self._proposer, self._decision = proposer, decision
        self._view = view
        self._verification = verification
        self._unverified: deque[Proposals] = deque()
        self._forgotten: list[int] = []  # locations that still belong to the present, whose features it needs
        self._pool = ThreadPoolExecutor(2, thread_name_prefix="verify")

    @property
    def takes_color(self) -> bool:
        """Whether the paradigm sees colour, and is to be given it where the recording has it."""
        return bool(getattr(self._proposer, "takes_color", False))

    @property
    def word_count(self) -> int | None:
        """Number of visual words in the map; None for a paradigm without words."""
        count: int | None = getattr(self._proposer, "word_count", None)
        return count

    def observe(self, image_id: int, image: NDArray[np.uint8], distance_travelled_m: float) -> list[Belief]:
        """Add an image and return the beliefs that are ready now (`PlaceRecognizer.observe`)."""
        check_image(image)
        gray = convert_channels(image, 1)
        features = self._features.get(image_id, gray)
        location = self._history.add(image_id, features, distance_travelled_m)
        color = image if image.ndim == 3 else None
        last_matchable = self._view.advance()
        self._erase_until(last_matchable)
        observed = ObservedImage(location, gray, features, distance_travelled_m, last_matchable, color)
        self._unverified.extend(self._proposer.observe(observed))
        return self._decide(_count_now(len(self._unverified)))

    def finish(self) -> list[Belief]:
        """Return the beliefs about the images that are still unanswered when the recording ends."""
        self._unverified.extend(self._proposer.finish())
        beliefs = self._decide(len(self._unverified)) + self._decision.finish()
        return [replace(belief, answered_at=self._latest_id) for belief in beliefs]

    def end_reference(self) -> None:
        """Make all images so far the reference: those that follow are matched with them alone.

        They are images of another recording. Nothing connects the first of them with the last one so far, none of them
        is ever a match, and the answers that still wait are dropped.
        """
        self.finish()
        if isinstance(self._proposer, ReferenceProposer):
            self._proposer.end_reference()
        self._decision.end_reference()
        self._view = FixedPast(self._history.latest)

    @property
    def can_forget(self) -> bool:
        """Whether the paradigm leaves images out of its map on request."""
        return isinstance(self._proposer, ForgetfulProposer)

    def forget(self, image_id: int) -> None:
        """Keep nothing of an image that was answered; it is never a match again (a ForgetfulRecognizer)."""
        assert isinstance(self._proposer, ForgetfulProposer)
        location = self._history.find_location(image_id)
        self._proposer.forget(location)
        self._forgotten.append(location)

    def _erase_until(self, last_matchable: int) -> None:
        """Erase the features of forgotten images that are past."""
        for location in [one for one in self._forgotten if one <= last_matchable]:
            self._history.images.erase(location)
            self._forgotten.remove(location)

    def _decide(self, count: int) -> list[Belief]:
        """Verify the next proposals and return the beliefs that follow."""
        beliefs: list[Belief] = []
        for _ in range(count):
            proposals = self._unverified.popleft()
            results = verify_candidates(
                self._history.images,
                proposals.query,
                proposals.locations,
                proposals.last_matchable,
                self._verification,
                self._pool,
            )
            beliefs += self._decision.add(proposals, results)
        return [replace(belief, answered_at=self._latest_id) for belief in beliefs]

    @property
    def _latest_id(self) -> int | None:
        return int(self._history.ids[-1]) if len(self._history) else None

    def state(self) -> dict[str, Any]:
        """Everything that changes from image to image, for a checkpoint."""
        return {
            "history": self._history.state(),
            "view": self._view.state(),
            "proposer": self._proposer.state(),
            "unverified": [dict(vars(proposals)) for proposals in self._unverified],
            "forgotten": list(self._forgotten),
            "decision": self._decision.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from the state of another recogniser of this configuration."""
        self._history.restore(state["history"])
        self._view.restore(state["view"])
        self._proposer.restore(state["proposer"])
        self._unverified.extend(Proposals(**proposals) for proposals in state["unverified"])
        self._forgotten = list(state["forgotten"])
        self._decision.restore(state["decision"])


def _count_now(waiting: int) -> int:
    """Return how many of the waiting proposals are verified with the present image."""
    return min(waiting, 1 if waiting <= _MAX_WAITING else 2)


class RowsById:
    """Hands rows on whose images are named by location, named by id (a MatrixSink)."""

    def __init__(self, history: ImageHistory, rows: MatrixSink | None) -> None:
        self._history, self._rows = history, NullMatrixSink() if rows is None else rows

    def add(
        self, query: int, matches: NDArray[np.int64], values: NDArray[np.float64], stage: str = "similarity"
    ) -> None:
        """Take one row (`MatrixSink.add`) of locations."""
        ids = self._history.ids
        self._rows.add(int(ids[query]), ids[matches], values, stage)
