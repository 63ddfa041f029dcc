"""Feature tracks that become visual words, and the map of these words: the bag of tracked words.

Tsintotas, Bampis, Gasteratos, 'Probabilistic Appearance-Based Place Recognition Through Bag of Tracked Words',
RA-L 4(2) 2019, sections III-A and III-B. A location is one image, counted from 0.
"""

from collections import deque
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from place_recognition.growing_array import GrowingArray
from place_recognition.image_processing.local_features import LocalFeatures
from place_recognition.vocabulary.word_tree import WordIndex

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class GuidedTrackingConfig:
    """Optical flow, and the conditions under which a feature continues a track.

    Attributes:
        max_distance_px: maximum distance of the detected feature from the position predicted by the flow.
        max_descriptor_distance: maximum distance of the feature's descriptor from the track's last one.
        window_px: side of the flow's window in the halved images.
        pyramid_levels: number of further halvings for the flow; each doubles the motion that can be followed.
        max_round_trip_px: maximum error of the flow forth and back.
    """

    max_distance_px: float = 5.0
    max_descriptor_distance: float = 0.6
    window_px: int = 13
    pyramid_levels: int = 2
    max_round_trip_px: float = 3.0


def optical_flow(
    previous: NDArray[np.uint8], image: NDArray[np.uint8], pixels: Floats, config: GuidedTrackingConfig
) -> Floats:
    """Track points (N, 2) of the previous image by optical flow.

    Args:
        previous: (H, W) uint8 image of the points.
        image: (H, W) uint8 image that follows; where its size is another one, all points are lost.
        pixels: (N, 2) positions in the previous image.
        config: settings of the flow.

    Returns:
        (N, 2) positions in the image; NaN for lost points.
    """
    if len(pixels) == 0 or previous.shape != image.shape:
        return np.full_like(pixels, np.nan)
    # A detected feature determines the position afterwards, so halved images suffice, in a third of the time.
    before, after, points = cv2.pyrDown(previous), cv2.pyrDown(image), pixels / 2
    size = (config.window_px, config.window_px)
    moved, found, _ = cv2.calcOpticalFlowPyrLK(
        before, after, points, None, winSize=size, maxLevel=config.pyramid_levels
    )
    # The flow back starts from the result, so two levels suffice; a full pyramid costs five times as much.
    back, found_back, _ = cv2.calcOpticalFlowPyrLK(
        after, before, moved, points.copy(), winSize=size, maxLevel=1, flags=cv2.OPTFLOW_USE_INITIAL_FLOW
    )
    error = 2 * np.linalg.norm(back - points, axis=1)
    kept = (found[:, 0] == 1) & (found_back[:, 0] == 1) & (error <= config.max_round_trip_px)
    moved[~kept] = np.nan
    return np.asarray(2 * moved, np.float32)


def select_guided(
    positions: Floats, descriptors: Floats, features: LocalFeatures, config: GuidedTrackingConfig
) -> NDArray[np.int64]:
    """Choose the feature (N,) that continues each track, -1 for none; no feature continues two tracks.

    Args:
        positions: (N, 2) pixels predicted by the flow, NaN for lost tracks.
        descriptors: (N, D) last descriptor of each track.
        features: features of the new image.
        config: limits of the distances.
    """
    limits = (config.max_distance_px, config.max_descriptor_distance)
    return _select(positions, descriptors, features.pixels, features.descriptors, limits)


@njit(cache=True, nogil=True)
def _select(
    positions: Floats, descriptors: Floats, pixels: Floats, candidates: Floats, limits: tuple[float, float]
) -> NDArray[np.int64]:
    chosen = np.full(len(positions), -1, np.int64)
    free = np.ones(len(pixels), np.bool_)
    for track in range(len(positions)):
        nearest, smallest = -1, limits[0] ** 2
        for k in range(len(pixels)):
            dx, dy = pixels[k, 0] - positions[track, 0], pixels[k, 1] - positions[track, 1]
            distance = dx * dx + dy * dy  # NaN is never less
            if free[k] and distance < smallest:
                nearest, smallest = k, distance
        if nearest >= 0:
            difference = descriptors[track] - candidates[nearest]
            if np.sum(difference * difference) < limits[1] ** 2:
                chosen[track] = nearest
                free[nearest] = False
    return chosen


Indices = NDArray[np.int64]


@dataclass(frozen=True)
class TrackConfig:
    """Conditions under which features are tracked and become words.

    Attributes:
        max_points: maximum number of points tracked at a time, nu in the paper.
        min_length_frames: minimum length of a track that becomes a word, rho in the paper; less where no track lasts so
            long.
        max_length_quantile: quantile of the lengths of all tracks that stands for the longest, c(t) in the paper.
        guided: conditions under which a feature continues a track.
    """

    max_points: int = 200
    min_length_frames: int = 5
    max_length_quantile: float = 0.95
    guided: GuidedTrackingConfig = field(default_factory=GuidedTrackingConfig)


@dataclass(frozen=True)
class Words:
    """Words of ended tracks, with the locations where they were seen.

    Attributes:
        descriptors: (K, D) float32 mean of the descriptors of each track, shorter than unit length.
        first, last: (K,) int64 first and last location of each track.
    """

    descriptors: Floats
    first: Indices
    last: Indices

    def __len__(self) -> int:
        return len(self.descriptors)


class FeatureTracks:
    """Tracks of the points that are followed from image to image."""

    def __init__(self, config: TrackConfig) -> None:
        self.config = config
        self._image: NDArray[np.uint8] | None = None
        self._location = -1
        self._reset()

    @property
    def descriptors(self) -> Floats:
        """(N, D) descriptors of the tracks in the latest image, which are the query to the map."""
        return self._descriptors

    @property
    def max_length_frames(self) -> int:
        """Length of the longest track but for the few that outlast all others; 0 without tracks.

        The paper takes the very longest. A speck on the lens or a cloud straight ahead never leaves the view, and one
        such track would keep the whole map from being searched.
        """
        if len(self._lengths) == 0:
            return 0
        return int(np.quantile(self._lengths, self.config.max_length_quantile, method="lower"))

    def advance(self, image: NDArray[np.uint8], features: LocalFeatures) -> Words:
        """Follow the points into the next image (H, W) uint8, and return the words of the tracks that end there."""
        chosen = np.empty(0, np.int64)
        if self._image is not None:
            positions = optical_flow(self._image, image, self._pixels, self.config.guided)
            chosen = select_guided(positions, self._descriptors, features, self.config.guided)
        ended = self._make_words(chosen < 0)
        self._location += 1
        self._image = image.copy()
        self._extend(chosen, features)
        self._refill(features, chosen)
        return ended

    def end(self) -> Words:
        """End all tracks, as the next image belongs to another recording, and return their words."""
        ended = self._make_words(np.ones(len(self._lengths), np.bool_))
        self._image = None
        self._reset()
        return ended

    @property
    def num_images(self) -> int:
        """Number of images so far."""
        return self._location + 1

    def _reset(self) -> None:
        self._pixels = np.empty((0, 2), np.float32)
        self._descriptors = self._sums = np.empty((0, 0), np.float32)
        self._lengths = np.empty(0, np.int64)

    def _make_words(self, lost: NDArray[np.bool_]) -> Words:
        """Return the words of the lost tracks that lasted long enough; they were last seen at the location so far."""
        # Where nothing stays in view for min_length_frames, as in a corridor seen every two seconds, the longest tracks
        # become words; but a single image is no track.
        word = lost & (self._lengths >= min(self.config.min_length_frames, max(self.max_length_frames, 2)))
        lengths = self._lengths[word]
        last = np.full(len(lengths), self._location, np.int64)
        means = (self._sums[word] / lengths[:, None]).astype(np.float32)
        return Words(means, last - lengths + 1, last)

    def _extend(self, chosen: Indices, features: LocalFeatures) -> None:
        """Keep the tracks that a feature continues, and add its descriptor to their sums."""
        going, feature = np.flatnonzero(chosen >= 0), chosen[chosen >= 0]
        self._pixels, self._descriptors = features.pixels[feature], features.descriptors[feature]
        sums = self._sums[going] if len(going) else np.empty((0, features.descriptors.shape[1]), np.float32)
        self._sums = sums + self._descriptors
        self._lengths = self._lengths[going] + 1

    def _refill(self, features: LocalFeatures, chosen: Indices) -> None:
        """Start tracks at the strongest features that continue no track."""
        unused = np.setdiff1d(np.arange(len(features)), chosen)[: max(self.config.max_points - len(self._lengths), 0)]
        self._pixels = np.concatenate([self._pixels, features.pixels[unused]])
        self._descriptors = np.concatenate([self._descriptors, features.descriptors[unused]])
        self._sums = np.concatenate([self._sums, features.descriptors[unused]])
        self._lengths = np.concatenate([self._lengths, np.ones(len(unused), np.int64)])

    def state(self) -> dict[str, Any]:
        """The tracks and the latest image, for a checkpoint."""
        return {
            "image": self._image,
            "location": self._location,
            "pixels": self._pixels,
            "descriptors": self._descriptors,
            "descriptor_sums": self._sums,
            "lengths": self._lengths,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._image, self._location = state["image"], state["location"]
        self._pixels, self._descriptors = state["pixels"], state["descriptors"]
        self._sums, self._lengths = state["descriptor_sums"], state["lengths"]


class WordMap:
    """All words, in the order in which their tracks ended; the active ones, which are past, can be found.

    A word waits until the exclusion window has moved past it. Only then does it enter the index, and for good; or
    never, if all images that showed it have been forgotten by then.
    """

    def __init__(self, index: WordIndex) -> None:
        self._index = index
        self._spans: GrowingArray[np.int32] = GrowingArray(np.int32)
        self._word_counts = np.zeros(0, np.int32)
        self._waiting: deque[Words] = deque()
        self._forgotten: set[int] = set()

    def __len__(self) -> int:
        return len(self._spans) + sum(map(len, self._waiting))

    @property
    def active_count(self) -> int:
        """Number of words that can be found."""
        return len(self._spans)

    def add(self, words: Words) -> None:
        """Add words whose tracks ended at one location, no earlier than that of the words before them."""
        if len(words):
            self._waiting.append(words)

    def activate_until(self, location: int) -> None:
        """Make the words that were last seen at a location or before findable."""
        while self._waiting and self._waiting[0].last[-1] <= location:
            words = self._without_forgotten(self._waiting.popleft())
            if not len(words):
                continue
            self._index.add(words.descriptors)
            self._spans.extend(np.stack([words.first, words.last], axis=1).astype(np.int32))
            self._count_words(words)

    def forget(self, location: int) -> None:
        """Leave an image out: words that no other image has shown do not enter the index."""
        self._forgotten.add(location)

    def is_forgotten(self, locations: Indices) -> NDArray[np.bool_]:
        """Whether the image at each of the locations (K,) was forgotten."""
        return np.array([location in self._forgotten for location in locations.tolist()], np.bool_)

    def _without_forgotten(self, words: Words) -> Words:
        if not self._forgotten:
            return words
        kept = [
            not self._forgotten.issuperset(range(first, last + 1))
            for first, last in zip(words.first.tolist(), words.last.tolist(), strict=True)
        ]
        return Words(words.descriptors[kept], words.first[kept], words.last[kept])

    def lookup(self, query: Floats) -> Indices:
        """Find the word (N,) that is nearest to each of the query descriptors (N, D); (0,) while none is active."""
        if self.active_count == 0 or len(query) == 0:
            return np.empty(0, np.int64)
        return self._index.nearest(query)

    def spans(self, words: Indices) -> NDArray[np.int32]:
        """Return the first and last location (K, 2) of words (K,)."""
        return self._spans.rows.reshape(-1, 2)[words]

    def words_at(self, locations: Indices) -> NDArray[np.int32]:
        """Count the active words (K,) that were seen at each of the locations (K,)."""
        return self._word_counts[locations]

    def _count_words(self, words: Words) -> None:
        """Add words to the counts of all locations where they were seen."""
        end = int(words.last.max()) + 1
        if end > len(self._word_counts):
            larger = np.zeros(max(end, 2 * len(self._word_counts)), np.int32)
            larger[: len(self._word_counts)] = self._word_counts
            self._word_counts = larger
        begin = int(words.first.min())
        self._word_counts[begin:end] += count_spans(words.first - begin, words.last - begin, end - begin)

    def state(self) -> dict[str, Any]:
        """All words, for a checkpoint."""
        return {
            "index": self._index.state(),
            "spans": self._spans.state(),
            "word_counts": self._word_counts,
            "waiting": [dict(vars(words)) for words in self._waiting],
            "forgotten": np.array(sorted(self._forgotten), np.int64),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._index.restore(state["index"])
        self._spans.restore(state["spans"])
        self._word_counts = state["word_counts"]
        self._waiting = deque(Words(**words) for words in state["waiting"])
        self._forgotten = set(state["forgotten"].tolist())


def count_spans(first: Indices, last: Indices, locations: int) -> NDArray[np.int32]:
    """Count the spans from first (K,) to last (K,), both included, that cover each location: (locations,)."""
    # A span adds one where it begins and takes it away behind its end: the running sum is the number of open spans.
    begins = np.bincount(first, minlength=locations + 1)
    ends = np.bincount(last + 1, minlength=locations + 1)
    return np.cumsum(begins - ends)[:locations].astype(np.int32)
