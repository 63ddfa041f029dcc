"""Localization of single images in a saved map: retrieval proposes key frames, geometric verification decides.

Retrieval finds the key frames that an image resembles by a bag of visual words. The words are descriptors of the map
itself, drawn at random: nothing is trained, and any kind of features works. Sivic, Zisserman, 'Video Google', ICCV
2003.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from place_recognition.image_processing.local_features import FeatureExtractor, LocalFeatures
from place_recognition.vocabulary.vocabulary_training import DescriptorSample
from place_recognition.vocabulary.word_tree import WordIndex, WordTree
from slam.errors import DataError
from slam.localization.absolute_pose import PoseConfig, estimate_camera_pose
from slam.localization.keyframe_map import LocalMapConfig, SavedMap, match_local_map
from slam.localization.pose_checks import AcceptanceConfig, Hypothesis, is_ambiguous, rejection_reason

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Floats = NDArray[np.float32]


@dataclass(frozen=True)
class IndexConfig:
    """Settings of the retrieval.

    Attributes:
        words: maximum number of words.
        seed: seed of their random choice.
    """

    words: int = 10000
    seed: int = 0


@dataclass(frozen=True)
class PlaceIndex:
    """Bags of words of the key frames.

    Attributes:
        search: index that finds the word of a descriptor.
        shares: (W,) share of the key frames in which each word occurs.
        profiles: (F, W) weighted words of each key frame, rows of unit length.
    """

    search: WordIndex
    shares: Array
    profiles: csr_array

    @classmethod
    def build(cls, frames: Callable[[], Iterable[Floats]], config: IndexConfig) -> Self:
        """Draw words from the descriptors (N, D) of all key frames, then index the key frames by them.

        Args:
            frames: returns an iterator over the descriptors of each key frame; at least one in all. Called twice.
            config: settings.
        """
        sample = DescriptorSample(config.words, config.seed)
        for descriptors in frames():
            sample.add(descriptors)
        search = WordTree()
        search.add(sample.descriptors)
        found = [_distinct(search, descriptors) for descriptors in frames()]
        columns = np.concatenate(found)
        rows = np.repeat(np.arange(len(found)), [len(words) for words in found])
        counts = np.bincount(columns, minlength=len(sample.descriptors))
        shares = (counts + 0.5) / (len(found) + 1.0)
        profiles = csr_array((-np.log(shares[columns]), (rows, columns)), shape=(len(found), len(shares)))
        lengths = np.sqrt(profiles.power(2).sum(axis=1))
        profiles.data /= np.repeat(np.maximum(lengths, 1e-12), np.diff(profiles.indptr))
        return cls(search, np.asarray(shares, np.float64), profiles)

    def similarity(self, descriptors: Floats) -> Array:
        """Similarity (F,) of each key frame to an image with descriptors (N, D): a correlation, at most 1."""
        if len(descriptors) == 0:
            return np.zeros(self.profiles.shape[0])
        words, weights = _distinct(self.search, descriptors), -np.log(self.shares)
        query = -self.shares * weights  # words that most key frames show carry no information
        query[words] += weights[words]
        return np.asarray(self.profiles @ query) / max(float(np.linalg.norm(weights[words])), 1e-12)


def _distinct(search: WordIndex, descriptors: Floats) -> NDArray[np.int64]:
    return np.unique(search.nearest(descriptors)) if len(descriptors) else np.empty(0, np.int64)


@dataclass(frozen=True)
class LocalizerConfig:
    """Settings of the localization.

    Attributes:
        max_candidates: maximum number of key frames that are verified.
        min_keyframe_gap: minimum distance between two candidates, key frames.
        coarse_offsets: key frames around a candidate whose landmarks are matched first, relative to it.
        fine_offsets: the same for the best candidates, which are verified again.
        index: settings of the retrieval.
        local_map: settings of the matching.
        pose: settings of the pose estimation.
        acceptance: when a pose is accepted.
    """

    max_candidates: int = 6
    min_keyframe_gap: int = 5
    coarse_offsets: tuple[int, ...] = (-2, 0, 2)
    fine_offsets: tuple[int, ...] = (-5, -3, -2, -1, 0, 1, 2, 3, 5)
    index: IndexConfig = field(default_factory=IndexConfig)
    local_map: LocalMapConfig = field(default_factory=LocalMapConfig)
    pose: PoseConfig = field(default_factory=PoseConfig)
    acceptance: AcceptanceConfig = field(default_factory=AcceptanceConfig)


@dataclass(frozen=True)
class LocalizationResult:
    """Pose of an image in the map.

    Attributes:
        T_world_camera: (4, 4) pose in the map, metres, or the unit of a map made with one camera.
        covariance: (6, 6) of its right perturbation, rotation first, relative to the matched image: errors of the
            map itself are not included.
        image: number of the matched image of the map.
        map_id: frame of reference.
        inliers: number of features that agree with the pose.
    """

    T_world_camera: Array
    covariance: Array
    image: int
    map_id: int
    inliers: int

    @property
    def sigma_m(self) -> float:
        """Standard deviation of the position, metres."""
        return float(np.sqrt(np.trace(self.covariance[3:, 3:])))

    @property
    def sigma_deg(self) -> float:
        """Standard deviation of the orientation, degrees."""
        return float(np.degrees(np.sqrt(np.trace(self.covariance[:3, :3]))))


@dataclass(frozen=True)
class NotLocalized:
    """An image for which no pose was accepted.

    Attributes:
        reason: reason with the numbers.
        image: number of the map's image with most inliers; None where there is none.
        inliers: number of features that agree with it.
    """

    reason: str
    image: int | None = None
    inliers: int = 0


class Localizer:
    """Localizes single images in a saved map, each by itself, in any order."""

    def __init__(self, saved: SavedMap, extractor: FeatureExtractor, config: LocalizerConfig | None = None) -> None:
        """Index the map, which takes some milliseconds a key frame."""
        self._saved, self._extractor, self._config = saved, extractor, config or LocalizerConfig()
        self._index = PlaceIndex.build(self._descriptors, self._config.index)

    def locate(self, image: Image) -> LocalizationResult | NotLocalized:
        """Find the pose of an image (H, W) uint8 of the map's camera.

        Raises:
            DataError: the map was made with other features.
        """
        features = self._extractor.extract(image)
        self._check_kind(features)
        coarse = self._verify(features, self._candidates(features), self._config.coarse_offsets)
        if not coarse or not len(coarse[0]):
            return NotLocalized(f"none of the {len(coarse)} likeliest places agrees with it on a pose")
        rivals = [other for other in coarse if is_ambiguous(self._saved, coarse[0], other, self._config.acceptance)]
        places = [hypothesis.place for hypothesis in (coarse[0], *rivals)]
        best, *others = self._verify(features, places, self._config.fine_offsets)
        reason = rejection_reason(best, others, features, self._saved, self._config.acceptance)
        if reason is not None or best.pose is None:
            return NotLocalized(reason or "no pose stands out among the matches", best.image, len(best))
        T_world_camera = self._saved.poses[best.image] @ best.pose.T_base_camera
        map_id = int(self._saved.map_id[best.image])
        return LocalizationResult(T_world_camera, best.pose.covariance, best.image, map_id, len(best))

    def _check_kind(self, features: LocalFeatures) -> None:
        if features.descriptors.shape[1] != self._saved.descriptor_size and len(features):
            raise DataError(
                f"{self._saved.store.path}: expected landmarks of {self._extractor.kind}, found descriptors of"
                f" {self._saved.descriptor_size} numbers; run again with these features"
            )

    def _descriptors(self) -> Iterator[NDArray[np.float32]]:
        for image in self._saved.key_frames:
            yield self._saved.landmarks(image).descriptors.astype(np.float32)

    def _candidates(self, features: LocalFeatures) -> Iterator[int]:
        """The most similar key frames that are not neighbours of one another, best first."""
        similarity, gap = self._index.similarity(features.descriptors), self._config.min_keyframe_gap
        for _ in range(self._config.max_candidates):
            best = int(np.argmax(similarity))
            if similarity[best] <= 0:
                return
            yield best
            similarity[max(best - gap, 0) : best + gap + 1] = -np.inf

    def _verify(self, features: LocalFeatures, places: Iterable[int], offsets: Sequence[int]) -> list[Hypothesis]:
        """Verify places by the key frames around them; the one with most inliers first."""
        hypotheses = [self._verify_place(features, place, offsets) for place in places]
        return sorted(hypotheses, key=lambda hypothesis: -len(hypothesis))

    def _verify_place(self, features: LocalFeatures, place: int, offsets: Sequence[int]) -> Hypothesis:
        saved, base = self._saved, int(self._saved.key_frames[place])
        matches = match_local_map(saved, base, saved.neighbors(place, offsets), features, self._config.local_map)
        pose = estimate_camera_pose(saved.camera, matches, self._config.pose)
        agreeing = np.empty(0, np.int64) if pose is None else np.unique(matches.features[pose.inliers])
        return Hypothesis(place, base, agreeing, pose)
