"""What the user asks to be read."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from slam.errors import ConfigError


def is_rate(fps: float) -> bool:
    """Whether so many images a second are a rate: from one in eleven days to what no camera reaches."""
    return 1e-6 <= fps <= 1e6


@dataclass(frozen=True)
class Source:
    """A recording, and how to read it.

    Attributes:
        path: folder or file.
        sequence: which of several drives below the folder; None where there is one.
        kind: layout, by its name in `slam.datasets.kinds.KINDS`; None to recognise it.
        fps: images a second, where no file says when they were taken.
        topics: of a bag: the left, then the right camera's; empty to find them.

    Raises:
        ConfigError: a rate that is none, or more topics than eyes.
    """

    path: Path
    sequence: str | None = None
    kind: str | None = None
    fps: float | None = None
    topics: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.fps is not None and not is_rate(self.fps):
            raise ConfigError(f"--fps: expected images a second above 0, found {self.fps}")
        if len(self.topics) > 2:
            raise ConfigError(f"--image-topic: expected one, or left and right, found {len(self.topics)}")

    def as_metrics(self) -> dict[str, object]:
        """What was asked, for metrics.json; what was not is left out."""
        return {name: value for name, value in asdict(self).items() if value not in (None, ())}

    @classmethod
    def from_metrics(cls, asked: Mapping[str, Any]) -> "Source":
        """What `as_metrics` said.

        Raises:
            KeyError, TypeError: it was not said.
        """
        known = dict(asked)
        return cls(Path(known.pop("path")), topics=tuple(known.pop("topics", ())), **known)
