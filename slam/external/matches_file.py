"""Loops from a file: the matches of another program take the place of the recogniser's, with its poses or without."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.local_features import LocalFeatures
from place_recognition.recognizer import Belief
from slam.errors import DataError
from slam.io.matches import ProposedLoop, read_proposed_loops
from slam.loop_closing.loop_closer import FrameLandmarks, LoopClosure, Rejection
from slam.system import LoopVerifier

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

FILE_PREFIX = "file:"  # of the name of a paradigm or an odometry that is read from a file

# Standard deviation of a relative pose of a file, which states none: wider than that of a pose measured here, so that a
# measured one counts for more, and narrow enough to correct drift.
_SIGMA_RAD, _SIGMA_M, _SIGMA_M_PER_M = 0.01, 0.1, 0.02


def path_of(name: str) -> Path | None:
    """File of a name such as `file:netvlad.csv`; None for any other name."""
    return Path(name.removeprefix(FILE_PREFIX)) if name.startswith(FILE_PREFIX) else None


def short_name(name: str) -> str:
    """Name for people and for folders: `file-netvlad` for `file:results/netvlad.csv`, any other name as it is."""
    path = path_of(name)
    return name if path is None else f"file-{path.stem}"


class FileRecognizer:
    """Proposes the matches of a file (a PlaceRecognizer). It looks at no image.

    A match is proposed with its query image, or with the image of the column answered_at. A query with several matches
    gets a belief for each, the surest first; one whose matches are missing gets one without a match.
    """

    def __init__(self, loops: dict[int, tuple[ProposedLoop, ...]]) -> None:
        self._loops = loops
        self._next = 0  # the first query that is unanswered
        self._latest = -1  # the last image that was observed

    def observe(self, image_id: int, image: Image, distance_travelled_m: float) -> list[Belief]:
        """Return the beliefs that are ready with this image."""
        self._latest = image_id
        return self._answer(image_id)

    def finish(self) -> list[Belief]:
        """Return the beliefs about the images that are still unanswered."""
        return self._answer(None)

    def end_reference(self) -> None:
        """Raise: a file matches the images of one recording (`slam.apps.places` refuses two)."""
        raise NotImplementedError

    def _answer(self, now: int | None) -> list[Belief]:
        """Answer the queries in order, up to the first that the file answers later than now."""
        beliefs = []
        while self._next <= self._latest:
            loops = self._loops.get(self._next, (ProposedLoop(Belief(self._next, None, 0.0, accepted=False)),))
            ready_at = max(loop.belief.answered_at or self._next for loop in loops)
            if now is not None and ready_at > now:
                break
            beliefs += [loop.belief for loop in loops]
            self._next += 1
        return beliefs

    def state(self) -> dict[str, Any]:
        """How far the queries are answered."""
        return {"next": self._next, "latest": self._latest}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._next, self._latest = state["next"], state["latest"]


class TrustedLoopVerifier:
    """Takes relative poses from a file, without looking at the images (a LoopVerifier).

    Loops without a pose in the file are verified by another verifier, which also keeps the landmarks.
    """

    def __init__(self, loops: dict[int, tuple[ProposedLoop, ...]], verifier: LoopVerifier) -> None:
        self._loops, self._verifier = loops, verifier

    def extract_landmarks(
        self, index: int, features: LocalFeatures, left: Image, right: Image | None
    ) -> FrameLandmarks:
        """Landmarks of a frame."""
        return self._verifier.extract_landmarks(index, features, left, right)

    def add_frame(self, index: int, landmarks: FrameLandmarks) -> None:
        """Keep the landmarks of a frame."""
        self._verifier.add_frame(index, landmarks)

    def forget(self, index: int) -> None:
        """Keep no landmarks of a frame."""
        self._verifier.forget(index)

    def verify(self, query: int, match: int) -> LoopClosure | Rejection:
        """Relative pose of two frames by the file, else by the landmarks, or why there is none."""
        for loop in self._loops.get(query, ()):
            if loop.belief.match == match and loop.T_match_query is not None:
                return LoopClosure(query, match, loop.T_match_query, _covariance(loop.T_match_query), inliers=0)
        return self._verifier.verify(query, match)


def _covariance(T_match_query: Array) -> Array:
    """Covariance (6, 6), rotation first, of a relative pose (4, 4) whose file states none."""
    sigma_m = _SIGMA_M + _SIGMA_M_PER_M * float(np.linalg.norm(T_match_query[:3, 3]))
    return np.diag(np.repeat(np.square([_SIGMA_RAD, sigma_m]), 3))


def check_matches_file(path: Path, num_images: int, trust_poses: bool = False) -> tuple[str, ...]:
    """Check that the matches of a file belong to a recording of so many images; remarks about the file.

    Raises:
        DataError: the file is missing or damaged, names an image that does not exist, or has no pose to be trusted.
    """
    found = read_proposed_loops(path)
    beyond = [query for query in found.by_query if query >= num_images]
    if beyond:
        raise DataError(
            f"{path}: expected queries below {num_images}, the number of images, found {beyond[0]}; export the matches "
            "of this drive, counted from 0"
        )
    if trust_poses and all(loop.T_match_query is None for loops in found.by_query.values() for loop in loops):
        raise DataError(
            f"{path}: expected relative poses (x, y, z, qx, qy, qz, qw), found none; leave out --trust-poses"
        )
    return found.remarks
