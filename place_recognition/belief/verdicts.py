"""Delayed decision of every paradigm: candidate beliefs go in, final beliefs come out some images later, in order."""

from typing import Any

from place_recognition.belief.bridge import GapFiller
from place_recognition.belief.hindsight import CandidateBeliefs, SequenceConsensus, SequenceConsensusConfig
from place_recognition.map.route import ImageHistory
from place_recognition.recognizer import Belief


class DelayedDecision:
    """One belief for each query, in order: first the sequence consensus decides, then short gaps are filled."""

    def __init__(self, route: ImageHistory, config: SequenceConsensusConfig) -> None:
        self._consensus, self._gap_filler = SequenceConsensus(config), GapFiller(route)

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
