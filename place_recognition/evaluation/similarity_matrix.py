"""The similarity matrix behind Figures 4.7, 4.8 and 4.12, recorded row by row in bounded memory."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

MAX_ROWS = 5000  # the longest dataset of the chapter has 4,541 images; a lower triangle takes 50 MB a stage


@dataclass(frozen=True)
class SimilarityMatrix:
    """Similarities of all pairs of images that a recogniser compared.

    Attributes:
        values: (M, M) float32, row = query, column = earlier image, NaN where the two were not compared; (M, K) where
            the columns are the images of a reference recording.
        step: number of neighbouring images that share a row and a column, which hold their largest value.
    """

    values: Floats
    step: int = 1


class MatrixRecorder:
    """Records the rows of a recogniser's matrix (a MatrixSink).

    Image ids count from 0. A recording of more than `max_rows` images does not outgrow the memory: each time the limit
    is reached, the resolution is halved. Two neighbouring images then share a row and a column, where the larger value
    stays.
    """

    def __init__(self, max_rows: int = MAX_ROWS) -> None:
        self._limit, self._step, self._first = max_rows, 1, 0
        self._reference: int | None = None  # number of images of the reference recording; None without one
        self._stages: dict[str, dict[int, Floats]] = {}

    @property
    def stages(self) -> tuple[str, ...]:
        """Names of the recorded matrices: "similarity", and "filtered" where there is a filter."""
        return tuple(self._stages)

    def restart(self, first: int) -> None:
        """Delete all rows; images count from the one with id `first` from now on, and earlier ones are left out."""
        self._step, self._first = 1, first
        self._stages = {}

    def end_reference(self, images: int) -> None:
        """Delete all rows; the `images` so far are the columns from now on, and those that follow the rows."""
        self._step, self._reference = 1, images
        self._stages = {}

    def add(self, query: int, matches: NDArray[np.int64], values: Array, stage: str = "similarity") -> None:
        """Record a row; ids and values as in `MatrixSink`. Rows may come late and more than once."""
        begin = self._first if self._reference is None else self._reference
        if query < begin:
            return
        query, matches = query - begin, np.asarray(matches, np.int64) - self._first
        values, matches = np.asarray(values)[matches >= 0], matches[matches >= 0]
        columns = query + 1 if self._reference is None else self._reference
        while max(query, columns - 1) // self._step >= self._limit:
            self._halve()
        row, cells = query // self._step, matches // self._step
        kept = self._stages.setdefault(stage, {})
        known = kept.get(row)
        if known is None:
            known = kept[row] = np.full((columns - 1) // self._step + 1, np.nan, np.float32)
        np.fmax.at(known, cells, np.asarray(values, np.float32))

    def matrix(self, images: int, stage: str = "similarity") -> SimilarityMatrix:
        """Return the matrix of the `images` queries so far; NaN throughout where a stage has no rows."""
        columns = images if self._reference is None else self._reference
        values = np.full((-(-images // self._step), -(-columns // self._step)), np.nan, np.float32)
        for row, known in self._stages.get(stage, {}).items():
            values[row, : len(known)] = known
        return SimilarityMatrix(values, self._step)

    def _halve(self) -> None:
        self._step *= 2
        for stage, kept in self._stages.items():
            smaller: dict[int, Floats] = {}
            for row, known in kept.items():
                folded = np.full(-(-len(known) // 2), np.nan, np.float32)
                np.fmax.at(folded, np.arange(len(known)) // 2, known)
                smaller[row // 2] = np.fmax(smaller[row // 2], folded) if row // 2 in smaller else folded
            self._stages[stage] = smaller

    def state(self) -> dict[str, Any]:
        """All rows, for a checkpoint."""
        stages = {stage: {"rows": list(kept), "values": list(kept.values())} for stage, kept in self._stages.items()}
        return {"step": self._step, "first_image": self._first, "stages": stages}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._step, self._first = state["step"], state["first_image"]
        self._stages = {
            stage: dict(zip(kept["rows"], kept["values"], strict=True)) for stage, kept in state["stages"].items()
        }
