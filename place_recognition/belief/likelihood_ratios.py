"""Likelihood ratios of what a candidate shows: how much likelier at a revisit than at a new place, in powers of ten.

Two observations count: the paradigm's own score of the candidate, and the evidence of geometry. The tables were fitted
once on drives that judge nothing, by `benchmarks/calibrate_place_filter.py`; figures: docs/decisions/place_filter.md.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RatioTable:
    """A piecewise linear function from a score to log10 of a likelihood ratio.

    Attributes:
        scores: (N,) knots, rising.
        log_ratios: (N,) values there; constant beyond the first and the last knot.
    """

    scores: tuple[float, ...]
    log_ratios: tuple[float, ...]

    def __call__(self, scores: Sequence[float] | Array) -> Array:
        """Return the values (K,) at scores (K,)."""
        return np.interp(np.asarray(scores, np.float64), self.scores, self.log_ratios)


# Evidence of geometry, in powers of ten.
GEOMETRY = RatioTable((0, 2, 5, 10, 20, 30, 45, 60, 100), (-2.0, -0.7, -0.3, 0.2, 1.2, 1.8, 2.7, 3.4, 5.0))

_WORDS = RatioTable(
    (0.005, 0.01, 0.02, 0.03, 0.04, 0.06, 0.1, 0.17, 0.28), (-2.7, -2.2, -1.6, -0.7, -0.1, 0.8, 1.6, 2.6, 3.1)
)

# Each paradigm's own score.
OWN_SCORES = {
    "sequence-histograms": _WORDS,
    "dynamic-sequences": _WORDS,
    "hierarchical-places": RatioTable((1.3, 2, 3.4, 6.6, 14, 31, 45), (-1.3, -0.7, -0.1, 0.8, 1.6, 2.2, 3.1)),
    "tracked-words": RatioTable((2, 2.8, 4.3, 8, 13.7, 21, 35, 60), (-3.0, -1.7, -0.9, 0.1, 1.2, 1.7, 2.9, 3.4)),
    "pixel-sequences": RatioTable((-0.3, 0.1, 0.4, 1.2, 2.4), (-0.4, -0.2, 0.4, 1.3, 3.4)),
    "global-descriptor": RatioTable((0.0,), (0.0,)),
    "seq-slam": RatioTable((0.0,), (0.0,)),
    "random-images": RatioTable((0.0,), (0.0,)),
}

# Of the descriptor of a network.
LEARNED_SCORE = RatioTable((2.2, 3.0, 3.7, 4.5, 5.5, 7.0, 9.0), (-1.5, -0.7, 0.0, 0.6, 1.3, 2.2, 3.0))


@dataclass(frozen=True)
class RatioWeights:
    """How much the two observations count: they are not independent of each other, nor from image to image.

    Attributes:
        own: power of the ratio of a paradigm's own score.
        geometry: power of the ratio of geometry.
        min_geometry: least log10 of the ratio of geometry.
    """

    own: float = 0.5
    geometry: float = 0.8
    min_geometry: float = -np.inf


# A network recognises a place in other light, where local features agree on nothing: that they do not says less then.
LEARNED_WEIGHTS = RatioWeights(own=1.0, min_geometry=-0.3)

# A candidate of less evidence than the best of its image shows the place from further away: its ratio falls by one
# power of ten for this evidence.
_EVIDENCE_PER_POWER = 40.0

# A place that is seen from elsewhere does not agree better than this: log10 of the ratio, and evidence.
_MAX_RATIO_ELSEWHERE, _MAX_EVIDENCE_ELSEWHERE = 5.0, 150.0

# Evidence from which a candidate's place is known better than usual.
_SHARP_EVIDENCE, _MAX_SHARPNESS = 90.0, 16.0


def log_ratios(own: Array, evidence: Array, weights: RatioWeights | None = None) -> Array:
    """Return log10 of the likelihood ratio (K,) of each candidate of an image.

    Args:
        own: (K,) log10 of the ratios of their own scores (`OWN_SCORES`).
        evidence: (K,) evidence of geometry of each.
        weights: how much both count; the defaults if None.
    """
    weights = weights or RatioWeights()
    behind = (evidence.max(initial=0.0) - evidence) / _EVIDENCE_PER_POWER
    geometry = np.maximum(GEOMETRY(evidence), weights.min_geometry)
    return weights.geometry * geometry + weights.own * own - behind


def log_ratios_elsewhere(ratios: Array, evidence: Array) -> Array:
    """Return the ratios (K,) of candidates that are seen from elsewhere, from those at the place: never as good."""
    too_good = np.maximum(evidence - _MAX_EVIDENCE_ELSEWHERE, 0.0) / _EVIDENCE_PER_POWER
    return np.minimum(ratios, _MAX_RATIO_ELSEWHERE) - too_good


def sharpness(evidence: Array) -> Array:
    """Return by how much (K,) the places of candidates are known better than usual, as inverse variances.

    Two images agree that strongly only where the cameras stood within a fraction of the usual distance.
    """
    return np.minimum(1.0 + (evidence / _SHARP_EVIDENCE) ** 3, _MAX_SHARPNESS)
