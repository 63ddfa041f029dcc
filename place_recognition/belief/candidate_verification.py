"""Geometric verification of candidate images, scored by how unlikely the agreement is by chance (a contrario).

A candidate is verified in three steps: its features are matched with the query's, one fundamental matrix is fitted to
the matches, and the number of inliers becomes an evidence in powers of ten (Moisan and Stival, IJCV 2004). Derivation
of the formula: docs/math.md. Reasons of the settings, with figures: docs/decisions/candidate_verification.md.
"""

import math
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from place_recognition.belief.geometric_verification import EpipolarConfig, epipolar_inliers, keeps_orientation
from place_recognition.image_processing.matching import count_matches, match_pairs
from place_recognition.map.feature_store import FeatureStore, StoredFeatures
from place_recognition.recognizer import no_pixels

Floats = NDArray[np.float32]

# Matches in a minimal sample: seven matches determine up to three fundamental matrices.
MINIMAL_SAMPLE = 7

_PARALLEL = 2  # candidates that are verified at a time


@dataclass(frozen=True)
class CandidateVerificationConfig:
    """Settings of the candidate verification.

    Attributes:
        max_ratio: largest ratio of nearest to second nearest descriptor distance of a match (Lowe). Of 0.75 to 0.95 on
            pairs of real images up to 30 m apart, 0.8 separates best.
        max_candidates: number of candidates of a query that are verified.
        refine_radius: number of images before and after the best candidate among which the best match is sought.
        refine_features: number of strongest features of each image that are compared for this.
        early_stop_evidence: evidence, in powers of ten, after which no further candidate is verified.
        epipolar: settings of the fundamental matrix.
    """

    max_ratio: float = 0.8
    max_candidates: int = 5
    refine_radius: int = 3
    refine_features: int = 200
    early_stop_evidence: float = 60.0
    epipolar: EpipolarConfig = field(default_factory=EpipolarConfig)


@dataclass(frozen=True)
class VerificationResult:
    """Result of the geometric verification of one candidate.

    Attributes:
        query: location (index among all images) of the query image.
        location: location of the earlier, matched image.
        inliers: number of matches that agree with one fundamental matrix; 0 if too few do.
        evidence: -log10 of the expected number of false alarms (`a_contrario_evidence`); 0 means no evidence.
        pixels: (inliers, 4) float32, x and y of the inliers in the query image, then in the matched image.
    """

    query: int
    location: int
    inliers: int
    evidence: float
    pixels: Floats = field(default_factory=no_pixels, compare=False, repr=False)


def verify_candidates(
    images: FeatureStore,
    query: int,
    candidates: Sequence[int],
    last_matchable: int,
    config: CandidateVerificationConfig,
    pool: Executor,
) -> tuple[VerificationResult, ...]:
    """Verify the candidates of a query in order, and the best image beside the best of them.

    Args:
        images: stored features of all images.
        query: location of the query image.
        candidates: locations, best first; the first `max_candidates` are verified.
        last_matchable: latest location that may be matched.
        config: how candidates are verified.
        pool: threads that verify two candidates at a time; the results do not depend on their number.
    """
    results: list[VerificationResult] = []
    for first in range(0, min(len(candidates), config.max_candidates), _PARALLEL):
        some = candidates[first : min(first + _PARALLEL, config.max_candidates)]
        results += pool.map(lambda location: verify_pair(images, query, location, config), some)
        if max(result.evidence for result in results) >= config.early_stop_evidence:
            break
    best = max(results, key=lambda result: result.evidence, default=None)
    if best is not None and best.evidence > 0:
        refined = _find_best_nearby(images, best, last_matchable, config)
        if refined not in {result.location for result in results}:
            results.append(verify_pair(images, query, refined, config))
    return tuple(results)


def verify_pair(
    images: FeatureStore, query: int, location: int, config: CandidateVerificationConfig
) -> VerificationResult:
    """Match two images and measure how many of their matches agree with one fundamental matrix."""
    now, then = images[query], images[location]
    pairs = match_pairs(now.quantized, then.quantized, config.max_ratio)
    query_pixels, candidate_pixels = now.pixels[pairs[:, 0]], then.pixels[pairs[:, 1]]
    mask = epipolar_inliers(query_pixels, candidate_pixels, config.epipolar)
    if mask is None:
        return VerificationResult(query, location, 0, 0.0)
    pixels = np.concatenate([query_pixels[mask], candidate_pixels[mask]], axis=1)
    if not keeps_orientation(pixels):
        return VerificationResult(query, location, 0, 0.0)
    evidence = a_contrario_evidence(len(pixels), len(pairs), _random_agreement(then, config.epipolar.max_distance_px))
    return VerificationResult(query, location, len(pixels), evidence, pixels)


def _find_best_nearby(
    images: FeatureStore, best: VerificationResult, last_matchable: int, config: CandidateVerificationConfig
) -> int:
    """Location with the most descriptor matches within the refine radius of the best result, itself included."""
    first = max(best.location - config.refine_radius, 0)
    nearby = range(first, min(best.location + config.refine_radius, last_matchable) + 1)
    descriptors = images[best.query].strongest(config.refine_features).quantized
    counts = count_matches(descriptors, *images.strongest(nearby, config.refine_features), config.max_ratio)
    return nearby[int(np.argmax(counts))]


def a_contrario_evidence(inliers: int, matches: int, random_agreement: float) -> float:
    """Return -log10 of the number of false alarms (NFA), at least 0.

    The NFA is the expected number of fundamental matrices with which as many of the matches agree by chance: Moisan
    and Stival, IJCV 57(3) 2004, equation 15, 3 (n - 7) C(n, k) C(k, 7) p^(k - 7).

    Args:
        inliers: k, at most n.
        matches: n.
        random_agreement: p, the probability that a random match agrees with a given matrix.
    """
    if inliers <= MINIMAL_SAMPLE:
        return 0.0
    choices = _log_choices(matches, inliers) + _log_choices(inliers, MINIMAL_SAMPLE)
    # 3: seven matches determine up to three fundamental matrices. n - 7: every number of inliers is tested.
    log_tests = math.log(3 * (matches - MINIMAL_SAMPLE)) + choices
    log_nfa = log_tests + (inliers - MINIMAL_SAMPLE) * math.log(random_agreement)
    return max(-log_nfa / math.log(10), 0.0)


def _random_agreement(features: StoredFeatures, max_distance_px: float) -> float:
    """Upper bound of the probability that a random point lies within the inlier distance of an epipolar line.

    The points are uniform in the bounding box of the features. No line through the box is longer than its diagonal, so
    the band of inliers covers at most 2 * distance * diagonal of its area.
    """
    if len(features.pixels) == 0:
        return 0.5
    width, height = np.maximum(np.ptp(features.pixels, axis=0), 1.0)
    return float(min(2 * max_distance_px * math.hypot(width, height) / (width * height), 0.5))


def _log_choices(total: int, chosen: int) -> float:
    """Natural logarithm of the binomial coefficient C(total, chosen)."""
    return math.lgamma(total + 1) - math.lgamma(chosen + 1) - math.lgamma(total - chosen + 1)
