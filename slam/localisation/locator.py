"""From an image to its pose in a map: places that look like it are proposed, and geometry decides."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.features import FeatureExtractor, LocalFeatures
from slam.errors import DataError
from slam.localisation.doubt import DoubtConfig, Hypothesis, doubt, rivals
from slam.localisation.index import IndexConfig, PlaceIndex
from slam.localisation.pose import PoseConfig, camera_pose
from slam.localisation.saved_map import SavedMap
from slam.localisation.view import ViewConfig, match_view

Array = NDArray[np.float64]
Image = NDArray[np.uint8]


@dataclass(frozen=True)
class LocatorConfig:
    """How an image is placed.

    Attributes:
        candidates: places that are looked at.
        apart: key frames from one of them to the next, at least.
        glance: key frames around a candidate whose landmarks are looked for, counted in key frames.
        look: the same for the best of them.
    """

    candidates: int = 6
    apart: int = 5
    glance: tuple[int, ...] = (-2, 0, 2)
    look: tuple[int, ...] = (-5, -3, -2, -1, 0, 1, 2, 3, 5)
    index: IndexConfig = field(default_factory=IndexConfig)
    view: ViewConfig = field(default_factory=ViewConfig)
    pose: PoseConfig = field(default_factory=PoseConfig)
    doubt: DoubtConfig = field(default_factory=DoubtConfig)


@dataclass(frozen=True)
class Located:
    """Where an image was taken.

    Attributes:
        T_world_camera: (4, 4) in the map, metres, or the unit of a map that one camera has made.
        covariance: (6, 6) of its right perturbation, rotation first, beside the matched image: the map's own errors
            do not count.
        image: of the map, beside which it was found.
        map_id: frame of reference.
        inliers: features that agree.
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
class NotFound:
    """An image that no place of the map explains.

    Attributes:
        reason: in plain words, with the numbers.
        image: of the map, that comes nearest; None where there is none.
        inliers: features that agree with it.
    """

    reason: str
    image: int | None = None
    inliers: int = 0


class Locator:
    """Places single images in a saved map; each by itself, in any order."""

    def __init__(self, saved: SavedMap, extractor: FeatureExtractor, config: LocatorConfig | None = None) -> None:
        """Index the map, which takes some milliseconds a key frame."""
        self._saved, self._extractor, self._config = saved, extractor, config or LocatorConfig()
        self._index = PlaceIndex.build(self._descriptors, self._config.index)

    def locate(self, image: Image) -> Located | NotFound:
        """Place an image (H, W) uint8 of the map's camera.

        Raises:
            DataError: the map is of other features.
        """
        features = self._extractor.extract(image)
        if features.descriptors.shape[1] != self._saved.numbers and len(features):
            raise DataError(
                f"{self._saved.store.path}: expected landmarks of {self._extractor.kind}, found descriptors of"
                f" {self._saved.numbers} numbers; let a run write it anew"
            )
        glances = [self._look(features, place, self._config.glance) for place in self._candidates(features)]
        glances.sort(key=lambda glance: -len(glance))
        if not glances or not len(glances[0]):
            return NotFound(f"none of the {len(glances)} likeliest places agrees with it on a pose")
        worth = [glance for glance in glances if rivals(self._saved, glances[0], glance, self._config.doubt)]
        looks = [self._look(features, glance.place, self._config.look) for glance in (glances[0], *worth)]
        best, *others = sorted(looks, key=lambda look: -len(look))
        reason = doubt(best, others, features, self._saved, self._config.doubt)
        if reason or best.pose is None:
            return NotFound(reason, best.image, len(best))
        T_world_camera = self._saved.poses[best.image] @ best.pose.T_base_camera
        map_id = int(self._saved.map_id[best.image])
        return Located(T_world_camera, best.pose.covariance, best.image, map_id, len(best))

    def _descriptors(self) -> Iterator[NDArray[np.float32]]:
        for image in self._saved.key_frames:
            yield self._saved.landmarks(image).descriptors.astype(np.float32)

    def _candidates(self, features: LocalFeatures) -> Iterator[int]:
        """The likeliest key frames that are some way from one another, best first."""
        likeness = self._index.likeness(features.descriptors)
        for _ in range(self._config.candidates):
            best = int(np.argmax(likeness))
            if likeness[best] <= 0:
                return
            yield best
            likeness[max(best - self._config.apart, 0) : best + self._config.apart + 1] = -np.inf

    def _look(self, features: LocalFeatures, place: int, offsets: Sequence[int]) -> Hypothesis:
        saved, base = self._saved, int(self._saved.key_frames[place])
        matches = match_view(saved, base, saved.beside(place, offsets), features, self._config.view)
        pose = camera_pose(saved.camera, matches, self._config.pose)
        agreeing = np.empty(0, np.int64) if pose is None else np.unique(matches.features[pose.inliers])
        return Hypothesis(place, base, agreeing, pose)
