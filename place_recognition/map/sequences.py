"""Where one sequence of images ends and the next begins: after a fixed way, or when the view has changed.

Bampis, Amanatiadis, Gasteratos, IROS 2016 (fixed way) and IJRR 37(1) 2018 (visual word variance).
"""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Indices = NDArray[np.int64]


class Segmentation(Protocol):
    """Cuts a drive into sequences that do not overlap."""

    def begins(self, words: Indices, travelled: float) -> bool:
        """Whether the next image begins a new sequence; the very first one does.

        Args:
            words: (N,) its words.
            travelled: way driven so far, metres; NaN, or always the same, where it is not measured.
        """
        ...

    def state(self) -> dict[str, Any]:
        """Everything that changes from image to image, for a checkpoint."""
        ...

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        ...


@dataclass(frozen=True)
class FixedWayConfig:
    """How long a sequence is.

    Attributes:
        way: metres; 3 to 6 were tried in the paper.
        images: where no way is measured, so many images instead: the paper's 5 m at 10 m/s and 10 images a second.
        most: images at which a sequence ends even if the car has hardly moved, as at a red light.
    """

    way: float = 5.0
    images: int = 5
    most: int = 20


class FixedWay:
    """Sequences of a fixed way by odometry (a Segmentation)."""

    def __init__(self, config: FixedWayConfig | None = None) -> None:
        self.config = config or FixedWayConfig()
        self._drive_begin = self._begin = float("nan")
        self._images = 0

    def begins(self, words: Indices, travelled: float) -> bool:
        """Whether the next image is too far from the first one of its sequence, or one too many."""
        if self._images == 0:
            self._drive_begin = travelled
        # NaN compares as False: then the number of images decides.
        measured = np.isfinite(travelled) and travelled != self._drive_begin
        far = measured and travelled - self._begin >= self.config.way
        full = self._images >= (self.config.most if measured else self.config.images)
        begins = self._images == 0 or far or full
        if begins:
            self._begin, self._images = travelled, 0
        self._images += 1
        return bool(begins)

    def state(self) -> dict[str, Any]:
        """Where the drive and the open sequence began, for a checkpoint."""
        return {"first_distance_m": self._drive_begin, "begin_distance_m": self._begin, "num_images": self._images}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._drive_begin, self._begin = state["first_distance_m"], state["begin_distance_m"]
        self._images = state["num_images"]


@dataclass(frozen=True)
class WordVarianceConfig:
    """When the view has changed.

    Attributes:
        limit: a sequence ends before an image of which a greater share of the distinct words is new to it.
        of_usual: or, if that is more, a greater share than this times what is usually new from one image to the next.
        least: images of a sequence before this is asked.
        most: images at which it ends anyway.
    """

    limit: float = 0.0
    of_usual: float = 1.0
    least: int = 2
    most: int = 10


class WordVariance:
    """Sequences of images that show the same words (a Segmentation)."""

    def __init__(self, words: int, config: WordVarianceConfig | None = None) -> None:
        self.config = config or WordVarianceConfig()
        self._seen = np.zeros(words, np.bool_)
        self._images = 0
        self._latest = np.empty(0, np.int64)
        self._changes = np.zeros(2)  # sum and number of the variances from one image to the next

    def begins(self, words: Indices, travelled: float) -> bool:
        """Whether the next image shows too much that its sequence has not shown, or is one too many."""
        distinct = np.unique(words)
        self._learn_usual(distinct)
        begins = self._images == 0 or self._images >= self.config.most or self._changed(distinct)
        if begins:
            self._seen[:] = False
            self._images = 0
        self._seen[distinct] = True
        self._images += 1
        return begins

    def _changed(self, distinct: Indices) -> bool:
        if self._images < self.config.least or len(distinct) == 0:
            return False
        variance = 1.0 - float(np.mean(self._seen[distinct]))
        return variance > max(self.config.limit, self.config.of_usual * self._usual())

    def _usual(self) -> float:
        """Mean variance from one image to the next so far; 0 before the second image."""
        return float(self._changes[0] / max(self._changes[1], 1))

    def _learn_usual(self, distinct: Indices) -> None:
        if len(distinct) and len(self._latest):
            self._changes += [1.0 - float(np.mean(np.isin(distinct, self._latest, assume_unique=True))), 1]
        if len(distinct):
            self._latest = distinct

    def state(self) -> dict[str, Any]:
        """The words of the open sequence and what usually changes, for a checkpoint."""
        return {
            "words_seen": self._seen,
            "num_images": self._images,
            "latest_words": self._latest,
            "changes": self._changes,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state.

        Raises:
            ValueError: of another number of words.
        """
        if len(state["words_seen"]) != len(self._seen):
            raise ValueError(f"expected a vocabulary of {len(self._seen)} words, got {len(state['words_seen'])}")
        self._seen, self._images = state["words_seen"], state["num_images"]
        self._latest, self._changes = state["latest_words"], state["changes"]
