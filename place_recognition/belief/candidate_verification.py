"""Geometric verification of candidate images, scored by how unlikely the agreement is by chance (a contrario).

A candidate is verified in three steps: its features are matched with the query's, one fundamental matrix is fitted to
the matches, and the number of inliers becomes an evidence in powers of ten (Moisan and Stival, IJCV 2004). Derivation
of the formula: docs/math.md. Reasons of the settings: docs/decisions/candidate_verification.md.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from place_recognition.belief.geometric_verification import EpipolarConfig, epipolar_inliers
from place_recognition.image_processing.matching import count_matches, match_pairs
from place_recognition.map.feature_store import FeatureStore, StoredFeatures
from place_recognition.recognizer import no_pixels

Floats = NDArray[np.float32]

# Matches in a minimal sample: seven matches determine up to three fundamental matrices.
MINIMAL_SAMPLE = 7


@dataclass(frozen=True)
class CandidateVerificationConfig:
    """Settings of the candidate verification.

    Attributes:
        ranking_ratio: largest ratio of nearest to second nearest descriptor distance of the matches that are counted
            to rank the candidates.
        ratio: the same ratio for the matches that are verified geometrically. It keeps nearly all matches, because the
            fundamental matrix separates good ones from bad ones.
        max_scale_ratio: largest ratio of the scales of two matched features. Images of one place show things at about
            the same size; matches beyond are mostly wrong, or show that the two cameras stood far apart.
        ranking_features: number of strongest features of each image used to rank the candidates.
        max_verified: largest number of candidates that are verified geometrically.
        max_follow_steps: largest number of steps from the best candidate to a neighbouring image of more evidence.
        object_share: radius of an object that may occur twice, as a share of the image width
            (`count_surplus_inliers`).
        early_stop_evidence: evidence, in powers of ten, after which no further candidate is verified.
        epipolar: settings of the fundamental matrix.
    """

    ranking_ratio: float = 0.8
    ratio: float = 0.95
    max_scale_ratio: float = 1.35
    ranking_features: int = 200
    max_verified: int = 4
    max_follow_steps: int = 3
    object_share: float = 0.1
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
        verified: whether enough matches agree.
        pixels: (inliers, 4) float32, x and y of the inliers in the query image, then in the matched image.
    """

    query: int
    location: int
    inliers: int
    evidence: float
    verified: bool
    pixels: Floats = field(default_factory=no_pixels, compare=False, repr=False)


@dataclass(frozen=True)
class ImagePairMatches:
    """Feature matches of a query image and a candidate, before any geometric verification.

    Attributes:
        query: location of the query image.
        location: location of the candidate.
        query_pixels: (N, 2) float32 pixels of the matches in the query image.
        candidate_pixels: (N, 2) float32 pixels of the matches in the candidate.
        random_agreement: probability that a random match agrees with a given fundamental matrix.
        object_radius_px: radius of an object that may occur twice, pixels.
    """

    query: int
    location: int
    query_pixels: Floats
    candidate_pixels: Floats
    random_agreement: float
    object_radius_px: float

    def verify(self, config: EpipolarConfig) -> VerificationResult:
        """Fit a fundamental matrix and return its inliers and their evidence."""
        mask = epipolar_inliers(self.query_pixels, self.candidate_pixels, config)
        if mask is None:
            return VerificationResult(self.query, self.location, 0, 0.0, verified=False)
        query_pixels = self.query_pixels[mask]
        surplus = count_surplus_inliers(query_pixels, self.object_radius_px)
        inliers, matches = len(query_pixels) - surplus, len(self.query_pixels) - surplus
        evidence = a_contrario_evidence(inliers, matches, self.random_agreement)
        pixels = np.concatenate([query_pixels, self.candidate_pixels[mask]], axis=1)
        return VerificationResult(self.query, self.location, len(query_pixels), evidence, verified=True, pixels=pixels)


def rank_candidates(
    images: FeatureStore, query: int, candidates: Sequence[int], config: CandidateVerificationConfig
) -> list[int]:
    """Return the `max_verified` candidates with the most feature matches, best first; ties keep their order."""
    if len(candidates) == 0:
        return []
    descriptors = images[query].strongest(config.ranking_features).quantized
    counts = count_matches(descriptors, *images.strongest(candidates, config.ranking_features), config.ranking_ratio)
    return [candidates[k] for k in np.argsort(-counts, kind="stable")[: config.max_verified]]


def match_images(
    images: FeatureStore, query: int, location: int, config: CandidateVerificationConfig
) -> ImagePairMatches:
    """Match the features of the query image with those of the image at an earlier location."""
    now, then = images[query], images[location]
    pairs = match_pairs(now.quantized, then.quantized, config.ratio)
    octave_difference = np.abs(now.octaves[pairs[:, 0]] - then.octaves[pairs[:, 1]])
    pairs = pairs[octave_difference <= math.log2(config.max_scale_ratio)]
    random_agreement = _random_agreement(then, config.epipolar.max_distance_px)
    radius = config.object_share * float(np.ptp(then.pixels[:, 0])) if len(then.pixels) else 0.0
    return ImagePairMatches(
        query, location, now.pixels[pairs[:, 0]], then.pixels[pairs[:, 1]], random_agreement, radius
    )


def count_surplus_inliers(pixels: Floats, radius_px: float) -> int:
    """Count the inliers (N, 2) that add no evidence because they lie on one repeated object.

    A parked car of the same make or the sign of a shop gives dozens of matches that agree with one another, in any
    street. All inliers within `radius_px` of one inlier are taken for one object, the fullest circle first. Each object
    counts as `MINIMAL_SAMPLE` inliers, which is what determines a fundamental matrix; the rest is surplus.
    """
    is_near = cdist(pixels, pixels, "sqeuclidean") <= radius_px**2
    surplus = 0
    while len(is_near):
        inside = is_near[int(is_near.sum(axis=1).argmax())]
        if inside.sum() <= MINIMAL_SAMPLE:
            break
        surplus += int(inside.sum()) - MINIMAL_SAMPLE
        is_near = is_near[~inside][:, ~inside]
    return surplus


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
