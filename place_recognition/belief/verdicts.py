"""The end of every paradigm: opinions go in, beliefs come out, once hindsight and the sure images around allow."""

from typing import Any

from place_recognition.belief.bridge import Bridge
from place_recognition.belief.hindsight import Hindsight, HindsightConfig, Opinion
from place_recognition.map.route import ImageHistory
from place_recognition.recognizer import Belief


class Verdicts:
    """One belief for each opinion, in order."""

    def __init__(self, route: ImageHistory, config: HindsightConfig) -> None:
        self._hindsight, self._bridge = Hindsight(config), Bridge(route)

    def add(self, opinion: Opinion) -> list[Belief]:
        """Take an opinion; the beliefs that are settled now."""
        return self._bridge.add(self._hindsight.add(opinion))

    def finish(self) -> list[Belief]:
        """The beliefs about the last images."""
        return self._bridge.add(self._hindsight.finish()) + self._bridge.finish()

    def state(self) -> dict[str, Any]:
        """Everything that waits for later images, for a checkpoint."""
        return {"consensus": self._hindsight.state(), "gaps": self._bridge.state()}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._hindsight.restore(state["consensus"])
        self._bridge.restore(state["gaps"])
