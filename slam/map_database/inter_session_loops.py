"""Translates image numbers between a session, whose frames the system counts, and a map of several sessions.

The system knows one session only, while its recogniser and its loop closer know the images of all sessions. The
wrappers of this module translate image numbers, and verify and collect matches with images of earlier sessions.
"""

import logging
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.local_features import FeatureCache, FeatureExtractor, LocalFeatures
from place_recognition.recognizer import Belief, ForgetfulRecognizer, PlaceRecognizer, can_forget, takes_color
from slam.frame_record import FrameRecord, LoopRecord
from slam.loop_closing.loop_closer import FrameLandmarks, LoopClosure, LoopVerification, Rejection
from slam.system import Components, LoopCandidate, LoopVerifier

Image = NDArray[np.uint8]

log = logging.getLogger("revisit")


@dataclass(frozen=True)
class SessionStart:
    """Start of a session for components that have processed other sessions before it.

    Attributes:
        image: number of its first image in the map.
        distance_m: path length before it, metres, including a gap so long that no rule takes an image of an earlier
            session for a recent one.
    """

    image: int = 0
    distance_m: float = 0.0


class SessionFeatures(FeatureCache):
    """The feature cache of a map, addressed by the frames of one session."""

    def __init__(self, cache: FeatureCache, first_image: int) -> None:
        self._cache, self._first_image = cache, first_image

    @property
    def kind(self) -> str:
        """Name of the descriptor."""
        return self._cache.kind

    @property
    def extractor(self) -> FeatureExtractor:
        """Extractor of the cache."""
        return self._cache.extractor

    def put(self, image_id: int, features: LocalFeatures) -> None:
        """Put the features of a frame of the session into the cache."""
        self._cache.put(self._first_image + image_id, features)

    def get(self, image_id: int, image: Image) -> LocalFeatures:
        """Features of a frame of the session."""
        return self._cache.get(self._first_image + image_id, image)


class SessionLoopCloser:
    """The loop closer of a map, addressed by the frames of one session (a LoopVerifier)."""

    def __init__(self, loop_closer: LoopVerifier, first_image: int) -> None:
        self._loop_closer, self._first_image = loop_closer, first_image

    def extract_landmarks(
        self, index: int, features: LocalFeatures, left: Image, right: Image | None
    ) -> FrameLandmarks:
        """Landmarks of a frame of the session."""
        return self._loop_closer.extract_landmarks(self._first_image + index, features, left, right)

    def add_frame(self, index: int, landmarks: FrameLandmarks) -> None:
        """Keep the landmarks of a frame of the session."""
        self._loop_closer.add_frame(self._first_image + index, landmarks)

    def forget(self, index: int) -> None:
        """Keep no landmarks of a frame of the session."""
        self._loop_closer.forget(self._first_image + index)

    def verify(self, query: int, match: int) -> LoopClosure | Rejection:
        """Relative pose of two frames of the session, or why there is none."""
        geometry = self._loop_closer.verify(self._first_image + query, self._first_image + match)
        return geometry if isinstance(geometry, Rejection) else _renumber_loop(geometry, -self._first_image)


class SessionRecognizer:
    """The recogniser of a map, addressed by the frames of one session (a PlaceRecognizer).

    A belief about a match with an earlier session is verified and collected here; for the system, the frame has no
    match.
    """

    def __init__(self, recognizer: PlaceRecognizer, loop_closer: LoopVerifier, start: SessionStart) -> None:
        self._recognizer, self._loop_closer, self._start = recognizer, loop_closer, start
        self._inter_session: dict[int, LoopRecord] = {}

    @property
    def takes_color(self) -> bool:
        """Whether the map's recogniser sees colour."""
        return takes_color(self._recognizer)

    @property
    def can_forget(self) -> bool:
        """Whether the map's recogniser forgets images."""
        return can_forget(self._recognizer)

    def forget(self, image_id: int) -> None:
        """Keep nothing of a frame of the session."""
        assert isinstance(self._recognizer, ForgetfulRecognizer)
        self._recognizer.forget(self._start.image + image_id)

    def observe(self, image_id: int, image: Image, travelled: float) -> list[Belief]:
        """Add a frame of the session; the beliefs about its frames that are ready now."""
        travelled += self._start.distance_m
        return self._in_session(self._recognizer.observe(self._start.image + image_id, image, travelled))

    def finish(self) -> list[Belief]:
        """The beliefs about frames of the session that are still open."""
        return self._in_session(self._recognizer.finish())

    def state(self) -> dict[str, Any]:
        """State of the map's recogniser."""
        return self._recognizer.state()

    def restore(self, state: dict[str, Any]) -> None:
        """Restore the map's recogniser."""
        self._recognizer.restore(state)

    def take_inter_session(self, query: int) -> LoopRecord | None:
        """The match of an image of the map with an earlier session, once; None where it has none."""
        return self._inter_session.pop(query, None)

    def _in_session(self, beliefs: Iterable[Belief]) -> list[Belief]:
        # The first answers of a session may be late ones about images of the session before.
        return [self._renumber(belief) for belief in beliefs if belief.query >= self._start.image]

    def _renumber(self, belief: Belief) -> Belief:
        if belief.match is not None and belief.match < self._start.image:
            self._collect(belief, belief.match)
        return belief_in_session(belief, self._start.image)

    def _collect(self, belief: Belief, match: int) -> None:
        geometry = self._loop_closer.verify(belief.query, match) if belief.accepted else None
        self._inter_session[belief.query] = LoopRecord(None, belief, geometry)
        if geometry is not None:
            outcome = "verified" if isinstance(geometry, LoopClosure) else geometry.reason
            log.info("frame %d -> image %d of an earlier session: %s", belief.query - self._start.image, match, outcome)


def components_in_session(components: Components, start: SessionStart) -> Components:
    """Components of a map for a system that counts the frames of one session only."""
    if start.image == 0:
        return components
    return replace(
        components,
        features=SessionFeatures(components.features, start.image),
        recognizer=SessionRecognizer(components.recognizer, components.loop_closer, start),
        loop_closer=SessionLoopCloser(components.loop_closer, start.image),
    )


def belief_in_session(belief: Belief, first_image: int) -> Belief:
    """A belief in the numbers of a session; without its match where that is an image of an earlier session."""
    shifted = _renumber_belief(belief, -first_image)
    if shifted.match is None or shifted.match >= 0:
        return shifted
    return Belief(shifted.query, None, 0.0, accepted=False, stages=shifted.stages, answered_at=shifted.answered_at)


def frame_in_session(record: FrameRecord, first_image: int) -> FrameRecord:
    """A frame of a map in the numbers of its session."""
    return replace(record, image=record.image - first_image)


def loop_in_session(record: LoopRecord, first_image: int) -> LoopRecord:
    """A loop of a map in the numbers of its session; without its match where that is of an earlier session."""
    belief = belief_in_session(record.belief, first_image)
    at_image = None if record.at_image is None else record.at_image - first_image
    inter_session = record.belief.match is not None and belief.match is None
    return LoopRecord(at_image, belief, None if inter_session else _renumber_geometry(record.geometry, -first_image))


def loop_in_map(candidate: LoopCandidate, at_image: int | None, first_image: int) -> LoopRecord:
    """A loop of a session in the numbers of the map; `at_image` is one of the map already."""
    belief = _renumber_belief(candidate.belief, first_image)
    return LoopRecord(at_image, belief, _renumber_geometry(candidate.geometry, first_image))


def _renumber_belief(belief: Belief, offset: int) -> Belief:
    """Shift all ids of a belief; candidates of an earlier session are left out."""

    def shift(image: int) -> int | None:
        return image + offset if image + offset >= 0 else None

    return replace(
        belief,
        query=belief.query + offset,
        match=None if belief.match is None else belief.match + offset,
        stages=belief.stages.renumber(shift),
        answered_at=None if belief.answered_at is None else belief.answered_at + offset,
    )


def _renumber_geometry(geometry: LoopVerification, offset: int) -> LoopVerification:
    return _renumber_loop(geometry, offset) if isinstance(geometry, LoopClosure) else geometry


def _renumber_loop(loop: LoopClosure, offset: int) -> LoopClosure:
    return replace(loop, query=loop.query + offset, match=loop.match + offset)
