"""The proof of a revisit: among candidate images the one that matches best, if one epipolar geometry explains it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from place_recognition.belief.geometric_verification import VerificationConfig, epipolar_inliers
from place_recognition.belief.quantised_matching import count_matches, match_pairs
from place_recognition.map.image_store import FeatureStore, StoredFeatures
from place_recognition.recognizer import no_pixels

Floats = NDArray[np.float32]

SAMPLE = 7  # matches that settle a fundamental matrix, of which there may be three


@dataclass(frozen=True)
class ProofConfig:
    """How candidates are compared.

    Attributes:
        likeness: nearest to second nearest descriptor distance of the matches by which candidates are ranked.
        ratio: the same for the matches that geometry is asked about: nearly all, as it tells good ones from bad.
        zoom: factor by which the scales of two matched features may differ: the same place shows things at about the
            same size, and what is left out is mostly wrong, or shows that the two cameras stood far apart.
        compared: strongest features of each image by which the candidates are ranked.
        tried: best candidates whose geometry is checked.
        followed: steps to a neighbour that says more, on a way that is certain.
        object_share: radius of an object that may occur twice, of the width of the image (`surplus_of_objects`).
        plenty: evidence of an image alone that leaves no doubt: no further candidate is looked at.
        verification: what proves a revisit.
    """

    likeness: float = 0.8
    ratio: float = 0.95
    zoom: float = 1.35
    compared: int = 200
    tried: int = 4
    followed: int = 3
    object_share: float = 0.1
    plenty: float = 60.0
    verification: VerificationConfig = field(default_factory=VerificationConfig)


@dataclass(frozen=True)
class Proof:
    """What geometry says of two images.

    Attributes:
        query, location: the later and the earlier image, by location.
        inliers: matches that agree with one epipolar geometry; 0 where too few do.
        evidence: powers of ten by which so much agreement is unlikely by chance (`chance_evidence`).
        verified: whether enough matches agree.
        pixels: (inliers, 4) float32, x and y of those matches in the later and in the earlier image.
    """

    query: int
    location: int
    inliers: int
    evidence: float
    verified: bool
    pixels: Floats = field(default_factory=no_pixels, compare=False, repr=False)


@dataclass(frozen=True)
class Pairing:
    """The matches of two images, of which geometry has not been asked yet.

    Attributes:
        query, location: the later and the earlier image, by location.
        now, then: (N, 2) float32 pixels of the matches in each.
        chance: probability that a random match agrees with a given fundamental matrix.
        object_size: radius of an object that may occur twice, pixels.
    """

    query: int
    location: int
    now: Floats
    then: Floats
    chance: float
    object_size: float

    def check(self, config: VerificationConfig) -> Proof:
        """What geometry says."""
        agree = epipolar_inliers(self.now, self.then, config)
        if agree is None:
            return Proof(self.query, self.location, 0, 0.0, verified=False)
        now = self.now[agree]
        surplus = surplus_of_objects(now, self.object_size)
        evidence = chance_evidence(len(now) - surplus, len(self.now) - surplus, self.chance)
        pixels = np.concatenate([now, self.then[agree]], axis=1)
        return Proof(self.query, self.location, len(now), evidence, verified=True, pixels=pixels)


def prove(images: FeatureStore, query: int, candidates: Sequence[int], config: ProofConfig) -> list[Proof]:
    """Verify those of the candidate locations that match best, best first; of equal ones the first."""
    return [verify(images, query, location, config) for location in rank(images, query, candidates, config)]


def rank(images: FeatureStore, query: int, candidates: Sequence[int], config: ProofConfig) -> list[int]:
    """The few candidate locations most of whose strongest features match, best first; of equal ones the first."""
    if len(candidates) == 0:
        return []
    now = images[query].strongest(config.compared).quantised
    likeness = count_matches(now, *images.strongest(candidates, config.compared), config.likeness)
    return [candidates[k] for k in np.argsort(-likeness, kind="stable")[: config.tried]]


def verify(images: FeatureStore, query: int, location: int, config: ProofConfig) -> Proof:
    """What geometry says of the image at a location as the place of the query."""
    return pair(images, query, location, config).check(config.verification)


def pair(images: FeatureStore, query: int, location: int, config: ProofConfig) -> Pairing:
    """The matches of a query and the image at an earlier location."""
    now, then = images[query], images[location]
    pairs = match_pairs(now.quantised, then.quantised, config.ratio)
    zoom = np.abs(now.octaves[pairs[:, 0]] - then.octaves[pairs[:, 1]])
    pairs = pairs[zoom <= math.log2(config.zoom)]
    chance = _chance(then, config.verification.distance)
    size = config.object_share * float(np.ptp(then.pixels[:, 0])) if len(then.pixels) else 0.0
    return Pairing(query, location, now.pixels[pairs[:, 0]], then.pixels[pairs[:, 1]], chance, size)


def surplus_of_objects(pixels: Floats, radius: float) -> int:
    """How many of the agreeing matches (N, 2) say no more than that some object was seen twice.

    A car of the same make at the same kerb, or the sign of a shop, has dozens of matches that agree with one another,
    and can be seen in any street. What lies within the radius of one match is taken for one object, the best filled
    circle first: it is counted for `SAMPLE` matches, those that settle a geometry, however many it has.
    """
    apart = cdist(pixels, pixels, "sqeuclidean") <= radius**2
    surplus = 0
    while len(apart):
        inside = apart[int(apart.sum(axis=1).argmax())]
        if inside.sum() <= SAMPLE:
            break
        surplus += int(inside.sum()) - SAMPLE
        apart = apart[~inside][:, ~inside]
    return surplus


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


def _chance(features: StoredFeatures, distance: float) -> float:
    """Probability that a random point of the features' bounding box lies so near to a line through it, at most."""
    if len(features.pixels) == 0:
        return 0.5
    width, height = np.maximum(np.ptp(features.pixels, axis=0), 1.0)
    return float(min(2 * distance * math.hypot(width, height) / (width * height), 0.5))


def _log_choices(total: int, chosen: int) -> float:
    return math.lgamma(total + 1) - math.lgamma(chosen + 1) - math.lgamma(total - chosen + 1)
