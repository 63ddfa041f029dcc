"""The present view: which of the latest images still show what the newest one shows, and are therefore no past.

An image may be matched only with images older than twice the present view, which reaches back to the oldest image that
still agrees with the newest one by geometry; older than the view alone where the camera comes back to its beginning.
This holds at any speed, standing or driving, whether or not a distance is measured. Reasons and figures:
docs/decisions/exclusion.md.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from place_recognition.growing_array import GrowingArray
from place_recognition.image_processing.matching import match_pairs
from place_recognition.map.image_history import ImageHistory
from place_recognition.verification.candidate_verification import EpipolarConfig, epipolar_inliers

# Images by which the beginning of the view advances at most for each new image: bounds the time of an image.
_MAX_STEPS = 4

# Images for which something may hide the whole view, as a lorry does, and the view goes on afterwards.
_MAX_HIDDEN = 30

_RETURN_RATIO = 3.0  # growth of the agreement with the beginning of the view by which the camera comes back to it

_MAX_RATIO = 0.8  # of nearest to second nearest descriptor distance, as in the verification of candidates
_STEP_FEATURES = 150  # strongest features of each image that are compared to see whether the camera has moved
_BESIDE = 3  # places within which successive steps show one stretch: recognised places are not exact
_STEP_SHARE = 0.0025  # displacement of the features by which it has, as a share of the image width


@dataclass(frozen=True)
class PresentViewConfig:
    """Extent of the present view.

    Attributes:
        min_gap_frames: number of images before the newest one that always belong to the present.
        min_distance_m: length of the path before the newest image that does; ignored while no distance is measured.
        min_inliers: number of matches that agree with one fundamental matrix by which two images show one view.
            Unrelated images reach 11.
        min_features: an image with fewer features shows nothing, and does not end the view.
        exclusion_frames: images nearer than this to the newest one are never matched either; 0 leaves it to the view.
            For comparisons with papers, which exclude a time.
        compared_features: number of strongest features of each image that are compared for this.
        epipolar: settings of the fundamental matrix.
    """

    min_gap_frames: int = 5
    min_distance_m: float = 20.0
    min_inliers: int = 12
    min_features: int = 30
    exclusion_frames: int = 0
    compared_features: int = 250
    epipolar: EpipolarConfig = field(default_factory=EpipolarConfig)


class PresentView:
    """Follows the present view, image by image."""

    def __init__(self, history: ImageHistory, config: PresentViewConfig | None = None) -> None:
        self.config = config or PresentViewConfig()
        self._history = history
        self._begin = 0  # location of the oldest image that agrees with the newest one
        self._reach = 0  # number of images of the view, and of those before that are excluded besides
        self._min_agreeing = np.inf  # smallest number of matches of a newest image with the beginning of the view
        self._returns = False  # whether the camera comes back to the beginning of the view
        self._whole = (0, 0)  # the latest image before the view began to shrink, and where the view began then

    def advance(self) -> int:
        """Follow the view to the newest image of the history; return the latest location that it may be matched with.

        -1 if there is none.
        """
        newest = self._history.latest
        if len(self._history.images[newest]) >= self.config.min_features:
            self._resume(newest)
            self._follow(newest)
            if newest - self._begin >= max(self._reach, 1):
                self._whole = (newest, self._begin)
        # Where something hides the view for a moment, as a lorry does, the view ends, but the past does not begin: the
        # reach falls by one image at a time.
        self._reach = max(newest - self._begin, self._reach - 1)
        by_count = newest - max(self.config.min_gap_frames, self.config.exclusion_frames)
        by_distance = self._history.last_behind(self.config.min_distance_m)
        before_view = self._begin - (0 if self._returns else self._reach)
        return max(min(before_view, by_count, by_distance), -1)

    def _resume(self, newest: int) -> None:
        """Go on with the view as it was if the newest image shows again what was seen before something hid it."""
        latest, begin = self._whole
        is_hidden = latest <= self._begin and newest - latest <= _MAX_HIDDEN
        if is_hidden and self._count_agreeing(newest, latest) >= self.config.min_inliers:
            self._begin = begin

    def _follow(self, newest: int) -> None:
        for _ in range(_MAX_STEPS):
            agreeing = self._count_agreeing(newest, self._begin) if self._begin < newest else np.inf
            if agreeing >= self.config.min_inliers:
                self._min_agreeing = min(self._min_agreeing, agreeing)
                # Driving on, the beginning of the view is seen less and less.
                self._returns = bool(np.isfinite(agreeing)) and agreeing >= _RETURN_RATIO * self._min_agreeing
                return
            self._begin, self._min_agreeing, self._returns = self._begin + 1, np.inf, False

    def _count_agreeing(self, newest: int, location: int) -> int:
        """Count the matches of two images that agree with one fundamental matrix."""
        now, then = (self._history.images[k].strongest(self.config.compared_features) for k in (newest, location))
        pairs = match_pairs(now.quantized, then.quantized, _MAX_RATIO)
        mask = epipolar_inliers(now.pixels[pairs[:, 0]], then.pixels[pairs[:, 1]], self.config.epipolar)
        return 0 if mask is None else int(mask.sum())

    def state(self) -> dict[str, Any]:
        """Everything that changes from image to image, for a checkpoint."""
        return {
            "view_begin": self._begin,
            "reach_frames": self._reach,
            "whole_view": list(self._whole),
            "min_agreeing": float(self._min_agreeing),
            "returns": self._returns,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._begin, self._reach = state["view_begin"], state["reach_frames"]
        self._whole = state["whole_view"][0], state["whole_view"][1]
        self._min_agreeing, self._returns = state["min_agreeing"], state["returns"]


class FixedWindow:
    """Excludes a fixed number of images before the newest one, as the published methods do (as PresentView)."""

    def __init__(self, history: ImageHistory, exclusion_frames: int) -> None:
        self._history, self._exclusion_frames = history, exclusion_frames

    def advance(self) -> int:
        """Return the latest location that the newest image may be matched with; -1 for none."""
        return max(self._history.latest - max(self._exclusion_frames, 1), -1)

    def state(self) -> dict[str, Any]:
        """Nothing."""
        return {}

    def restore(self, state: dict[str, Any]) -> None:
        """Nothing."""


class FixedPast:
    """Takes everything up to one image for the past, whatever comes after it (as PresentView).

    A reference recording is the past of another one: all its images may be matched, and no image of the other.
    """

    def __init__(self, last: int) -> None:
        self._last = last

    def advance(self) -> int:
        """Return the last location that any image may be matched with; -1 for none."""
        return self._last

    def state(self) -> dict[str, Any]:
        """Nothing."""
        return {}

    def restore(self, state: dict[str, Any]) -> None:
        """Nothing."""


class CameraSteps:
    """Counts the steps of the camera, and the places that it saw: a standing camera takes many images of one step.

    Places are counted in steps, so that a stop, or a recording at another frame rate, does not change how fast a
    revisit moves along the earlier pass. Each step shows a place of its own, until it is recognised as an earlier one.
    """

    def __init__(self, history: ImageHistory) -> None:
        self._history = history
        self._firsts: list[int] = []  # location of the first image of each step
        self._steps: GrowingArray[np.int64] = GrowingArray(np.int64)  # step of each image
        self._places: GrowingArray[np.int64] = GrowingArray(np.int64)  # place of each step
        self._junctions: dict[int, tuple[int, int]] = {}  # places of a step and of the next one, where they lie apart
        self._reference_end = -1  # number of steps of the reference recording; -1 while there is no such recording

    def add(self, location: int) -> bool:
        """Add the next image; return whether the camera has moved since the first image of its latest step."""
        is_new = len(self._firsts) in (0, self._reference_end)  # not a neighbour of the image before, however alike
        moved = is_new or self._has_moved(self._firsts[-1], location)
        if moved:
            self._places.extend(np.array([len(self._firsts)]))
            self._firsts.append(location)
            self._compare_with_next(len(self._firsts) - 2)
        self._steps.extend(np.array([len(self._firsts) - 1]))
        return moved

    def of(self, location: int) -> int:
        """Return the step of the image at a location."""
        return int(self._steps.rows.reshape(-1)[location])

    def places(self, locations: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the places (K,) that the images at locations (K,) show, as the steps that saw them first."""
        places: NDArray[np.int64] = self._places.rows.reshape(-1)[self._steps.rows.reshape(-1)[locations]]
        return places

    def end_reference(self) -> None:
        """Let the next image begin another recording, whose steps are no places of the map and join none of them."""
        self._reference_end = len(self._firsts)

    def recognize(self, step: int, place: int) -> None:
        """Let a step show an earlier place from now on."""
        if self._reference_end >= 0:
            return
        self._places.rows.reshape(-1)[step] = place
        self._compare_with_next(step - 1)
        self._compare_with_next(step)

    def junctions(self) -> NDArray[np.int64]:
        """Return the places (J, 2) of successive steps where they lie apart: a pass meets or leaves an earlier one."""
        return np.array([self._junctions[step] for step in sorted(self._junctions)], np.int64).reshape(-1, 2)

    def _compare_with_next(self, step: int) -> None:
        if self._reference_end >= 0:
            return
        self._junctions.pop(step, None)
        shown = self._places.rows.reshape(-1)[max(step, 0) : step + 2]
        if len(shown) == 2 and abs(int(shown[1]) - int(shown[0])) > _BESIDE:
            self._junctions[step] = int(shown[0]), int(shown[1])

    def images(self, step: int) -> range:
        """Return the locations of the images of a step."""
        end = self._firsts[step + 1] if step + 1 < len(self._firsts) else len(self._steps)
        return range(self._firsts[step], end)

    def __len__(self) -> int:
        return len(self._firsts)

    def _has_moved(self, first: int, location: int) -> bool:
        now, then = (self._history.images[k].strongest(_STEP_FEATURES) for k in (location, first))
        pairs = match_pairs(now.quantized, then.quantized, _MAX_RATIO)
        if len(pairs) < _STEP_FEATURES // 10:
            return True
        shift = np.linalg.norm(now.pixels[pairs[:, 0]] - then.pixels[pairs[:, 1]], axis=1)
        width = float(np.ptp(then.pixels[:, 0]))
        return bool(np.median(shift) > _STEP_SHARE * width)

    def state(self) -> dict[str, Any]:
        """Everything that changes from image to image, for a checkpoint."""
        return {
            "first_images": list(self._firsts),
            "steps": self._steps.state(),
            "places": self._places.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._firsts = list(state["first_images"])
        self._steps.restore(state["steps"])
        self._places.restore(state["places"])
        for step in range(len(self._firsts) - 1):
            self._compare_with_next(step)
