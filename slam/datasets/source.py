"""The user's request for a dataset: path, format and the values that the files do not contain."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from slam.errors import ConfigError

# Frames per second that a recording can have: from one image in eleven days to beyond any camera.
_MIN_FPS, _MAX_FPS = 1e-6, 1e6


def is_valid_fps(fps: float) -> bool:
    """Whether a number can be a frame rate, in images per second."""
    return _MIN_FPS <= fps <= _MAX_FPS


@dataclass(frozen=True)
class DatasetSpec:
    """A dataset to open, and how to read it.

    Attributes:
        path: folder or file.
        sequence: name of one of several sequences below the folder; None where there is only one.
        format: name of a format in `slam.datasets.kinds.FORMATS`; None to detect it.
        fps: images per second, for recordings without timestamps.
        topics: image topics of a bag, the left camera's first; empty to find them.

    Raises:
        ConfigError: `fps` is not a frame rate, or there are more than two topics.
    """

    path: Path
    sequence: str | None = None
    format: str | None = None
    fps: float | None = None
    topics: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.fps is not None and not is_valid_fps(self.fps):
            raise ConfigError(f"--fps: expected images per second, above 0, found {self.fps}")
        if len(self.topics) > 2:
            raise ConfigError(f"--image-topic: expected one, or left and right, found {len(self.topics)}")

    def as_metrics(self) -> dict[str, object]:
        """Return the fields that were given, for metrics.json."""
        return {name: value for name, value in asdict(self).items() if value not in (None, ())}

    @classmethod
    def from_metrics(cls, fields: Mapping[str, Any]) -> "DatasetSpec":
        """Return the specification that `as_metrics` has written.

        Raises:
            KeyError, TypeError: the fields are not those of a specification.
        """
        rest = dict(fields)
        return cls(Path(rest.pop("path")), topics=tuple(rest.pop("topics", ())), **rest)
