"""The proof of a revisit: among candidate images the one that matches best, if one epipolar geometry explains it."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from scipy.special import gammaln

from place_recognition.belief.geometric_verification import VerificationConfig, epipolar_inliers
from place_recognition.belief.matching import mutual_matches
from place_recognition.map.image_store import ImageStore, StoredFeatures

SAMPLE = 7  # matches that settle a fundamental matrix, of which there may be three


@dataclass(frozen=True)
class ProofConfig:
    """How candidates are compared.

    Attributes:
        ratio: nearest to second nearest descriptor distance of a match between two images.
        compared: strongest features of each image by which the candidates are ranked.
        tried: best candidates whose geometry is checked.
        verification: what proves a revisit.
    """

    ratio: float = 0.8
    compared: int = 200
    tried: int = 2
    verification: VerificationConfig = field(default_factory=VerificationConfig)


@dataclass(frozen=True)
class Proof:
    """What geometry says of two images.

    Attributes:
        query, location: the later and the earlier image, by location.
        inliers: matches that agree with one epipolar geometry; 0 where too few do.
        evidence: powers of ten by which so much agreement is unlikely by chance (`chance_evidence`).
        verified: whether enough matches agree.
    """

    query: int
    location: int
    inliers: int
    evidence: float
    verified: bool


def prove(images: ImageStore, query: int, candidates: Iterable[int], config: ProofConfig) -> list[Proof]:
    """Verify those of the candidate locations that match best, best first; of equal ones the first."""
    ranked = sorted(candidates, key=lambda location: -_likeness(images, query, location, config))
    return [verify(images, query, location, config) for location in ranked[: config.tried]]


def verify(images: ImageStore, query: int, location: int, config: ProofConfig) -> Proof:
    """What geometry says of the image at a location as the place of the query."""
    now, then = images[query], images[location]
    pairs = mutual_matches(now.descriptors, then.descriptors, config.ratio)
    agree = epipolar_inliers(now.pixels[pairs[:, 0]], then.pixels[pairs[:, 1]], config.verification)
    if agree is None:
        return Proof(query, location, 0, 0.0, verified=False)
    inliers = int(np.count_nonzero(agree))
    evidence = chance_evidence(inliers, len(pairs), _chance(then, config.verification.distance))
    return Proof(query, location, inliers, evidence, verified=True)


def chance_evidence(inliers: int, matches: int, chance: float) -> float:
    """-log10 of the expected number of fundamental matrices that so many of the matches would agree with by chance.

    Moisan, Stival, 'A Probabilistic Criterion to Detect Rigid Point Matches Between Two Images and Estimate the
    Fundamental Matrix', IJCV 57(3) 2004, equation 15: 3 (n - 7) C(n, k) C(k, 7) chance^(k - 7).

    Args:
        inliers: k, at most n.
        matches: n.
        chance: probability that a random match agrees with a given matrix.
    """
    if inliers <= SAMPLE:
        return 0.0
    choices = _log_choices(matches, inliers) + _log_choices(inliers, SAMPLE)
    log_number = math.log(3 * (matches - SAMPLE)) + choices + (inliers - SAMPLE) * math.log(chance)
    return max(-log_number / math.log(10), 0.0)


def _likeness(images: ImageStore, query: int, location: int, config: ProofConfig) -> int:
    now, then = (images[k].strongest(config.compared).descriptors for k in (query, location))
    return len(mutual_matches(now, then, config.ratio))


def _chance(features: StoredFeatures, distance: float) -> float:
    """Probability that a random point of the features' bounding box lies so near to a line through it, at most."""
    width, height = np.maximum(np.ptp(features.pixels, axis=0), 1.0)
    return float(min(2 * distance * math.hypot(width, height) / (width * height), 0.5))


def _log_choices(total: int, chosen: int) -> float:
    return float(gammaln(total + 1) - gammaln(chosen + 1) - gammaln(total - chosen + 1))
