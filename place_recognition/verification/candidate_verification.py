"""Geometric verification of candidate images, scored by how unlikely the agreement is by chance (a contrario).

A candidate is verified in three steps: its features are matched with the query's, one fundamental matrix is fitted to
the matches, and the number of inliers becomes an evidence in powers of ten (Moisan and Stival, IJCV 2004). Derivation
of the formula: docs/math.md. Reasons of the settings, with figures: docs/decisions/candidate_verification.md.
"""

import math
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.matching import count_matches, match_pairs
from place_recognition.map.feature_store import FeatureStore, StoredFeatures
from place_recognition.recognizer import no_pixels

Floats = NDArray[np.float32]
Mask = NDArray[np.bool_]

# Matches in a minimal sample: seven matches determine up to three fundamental matrices, so that they always agree.
MINIMAL_SAMPLE = 7

_TRIANGLE_STEPS = 5  # as many triangles for each match
_PARALLEL = 2  # candidates that are verified at a time


@dataclass(frozen=True)
class EpipolarConfig:
    """When matches agree with a fundamental matrix, and when enough of them do.

    Attributes:
        min_inliers: smallest number of inliers for which a pair counts as agreeing at all. Unrelated images reach
            eleven, and to fit as few matches takes the longest.
        max_distance_px: largest distance of an inlier from its epipolar line, pixels.
        max_iterations: largest number of samples drawn.
        confidence: probability of having drawn a sample without outliers at which the search stops early.
        seed: seed of the samples.
    """

    min_inliers: int = 12
    max_distance_px: float = 2.0
    max_iterations: int = 500
    confidence: float = 0.999
    seed: int = 0


def epipolar_inliers(first: Floats, second: Floats, config: EpipolarConfig) -> Mask | None:
    """Find the matches that agree with one fundamental matrix, by MAGSAC (Barath et al., CVPR 2019).

    Args:
        first: (N, 2) pixels of the matches in one image.
        second: (N, 2) pixels of the matches in the other image.
        config: inlier distance, number of inliers and iterations.

    Returns:
        Mask (N,) of the inliers, or None where fewer than `min_inliers` agree. The same for the same input.
    """
    if len(first) < max(config.min_inliers, MINIMAL_SAMPLE + 1):
        return None
    pixels = np.asarray(first, np.float64), np.asarray(second, np.float64)
    # From one viewpoint every fundamental matrix agrees with what has not moved, and the search ends with any.
    still = np.linalg.norm(pixels[0] - pixels[1], axis=1) <= config.max_distance_px
    if 2 * np.count_nonzero(still) >= len(still):
        return still if np.count_nonzero(still) >= config.min_inliers else None
    try:
        _, mask = cv2.findFundamentalMat(*pixels, _usac_parameters(config))
    except cv2.error:  # degenerate matches leave OpenCV without a model, and some versions raise an error then
        return None
    if mask is None or np.count_nonzero(mask) < config.min_inliers:
        return None
    return np.asarray(mask.ravel(), np.bool_)


def keeps_orientation(pixels: Floats) -> bool:
    """Decide whether most triangles of matches turn the same way in both images: a mirrored street is another street.

    No fundamental matrix can tell: mirroring one image turns a valid matrix into another valid one. Of true pairs up to
    30 m and 45 degrees apart, 99 in 100 keep 0.58 of the triangles or more; of mirrored ones 95 keep less than 0.25.

    Args:
        pixels: (N, 4) x and y of each match in one image, then in the other, in an order that follows no direction.
    """
    count, kept = len(pixels), 0
    for step in range(1, _TRIANGLE_STEPS + 1):
        side = np.roll(pixels, -step, axis=0) - pixels
        other = np.roll(pixels, -2 * step, axis=0) - pixels
        areas = side[:, 0::2] * other[:, 1::2] - side[:, 1::2] * other[:, 0::2]
        kept += int(np.count_nonzero(areas[:, 0] * areas[:, 1] >= 0))
    return 2 * kept >= _TRIANGLE_STEPS * count


def _usac_parameters(config: EpipolarConfig) -> Any:
    parameters = cv2.UsacParams()
    parameters.score = cv2.SCORE_METHOD_MAGSAC
    parameters.loMethod = cv2.LOCAL_OPTIM_SIGMA
    parameters.threshold = config.max_distance_px
    parameters.maxIterations = config.max_iterations
    parameters.confidence = config.confidence
    parameters.randomGeneratorState = config.seed  # with isParallel off: the same inliers in every run
    parameters.isParallel = False
    return parameters


@dataclass(frozen=True)
class CandidateVerificationConfig:
    """Settings of the candidate verification.

    Attributes:
        max_ratio: largest ratio of nearest to second nearest descriptor distance of a match (Lowe). Of 0.75 to 0.95 on
            pairs of real images up to 30 m apart, 0.8 separates best.
        max_learned_ratio: the same for local features of a network, whose descriptors lie closer together.
        max_candidates: number of candidates of a query that are verified.
        refine_radius: number of images before and after the best candidate among which the best match is sought.
        refine_features: number of strongest features of each image that are compared for this.
        early_stop_evidence: evidence, in powers of ten, after which no further candidate is verified.
        epipolar: settings of the fundamental matrix.
    """

    max_ratio: float = 0.8
    max_learned_ratio: float = 0.95
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
    pool: Executor | None = None,
) -> tuple[VerificationResult, ...]:
    """Verify the candidates of a query in order, and the best image beside the best of them.

    Args:
        images: stored features of all images.
        query: location of the query image.
        candidates: locations, best first; the first `max_candidates` are verified.
        last_matchable: latest location that may be matched.
        config: how candidates are verified.
        pool: threads that verify two candidates at a time, for speed alone; None for none.
    """
    results: list[VerificationResult] = []
    for first in range(0, min(len(candidates), config.max_candidates), _PARALLEL):
        some = candidates[first : min(first + _PARALLEL, config.max_candidates)]
        verify = partial(verify_pair, images, query, config=config)
        results += map(verify, some) if pool is None else pool.map(verify, some)
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
