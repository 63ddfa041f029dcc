"""Likelihood ratios of what a candidate shows: how much likelier at a revisit than at a new place, in powers of ten.

Two observations count: the paradigm's own score of the candidate, and the evidence of geometry. The tables were fitted
once on drives that judge nothing, by `benchmarks/calibrate_place_filter.py`; figures: docs/decisions/place_filter.md.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

# Knots (evidence in powers of ten, log10 of the likelihood ratio); linear between them, constant beyond.
GEOMETRY_RATIOS = ((0.0, -0.7), (5.0, 0.0), (55.0, 6.0))

# Evidence at which a candidate's location is known better than usual (`locate_sharply`).
_SHARP_EVIDENCE = 120.0


@dataclass(frozen=True)
class RatioTable:
    """A piecewise linear function from a score to log10 of a likelihood ratio.

    Attributes:
        scores: (N,) knots, rising.
        log_ratios: (N,) values there; constant beyond the first and the last knot.
    """

    scores: tuple[float, ...]
    log_ratios: tuple[float, ...]

    def __call__(self, scores: ArrayLike) -> Array:
        """Return the values (...) at scores (...)."""
        return np.interp(scores, self.scores, self.log_ratios)


_NEUTRAL = RatioTable((0.0,), (0.0,))
OWN_SCORES = {
    "sequence-histograms": _NEUTRAL,
    "dynamic-sequences": _NEUTRAL,
    "hierarchical-places": _NEUTRAL,
    "tracked-words": _NEUTRAL,
    "pixel-sequences": _NEUTRAL,
    "global-descriptor": _NEUTRAL,
    "random-images": _NEUTRAL,
}

GEOMETRY = RatioTable(*map(tuple, zip(*GEOMETRY_RATIOS, strict=True)))  # type: ignore[arg-type]


def sharpness(evidence: ArrayLike) -> Array:
    """Return by how much (...) candidates of this evidence are located better than usual, as inverse variances.

    Two images agree that strongly only where the cameras stood within a fraction of the usual distance.
    """
    return 1.0 + (np.asarray(evidence, np.float64) / _SHARP_EVIDENCE) ** 3
