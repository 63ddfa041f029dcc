"""A system counts the frames of its session; recogniser and loop closer behind it count all images of the map."""

import numpy as np
import pytest

from odometry.motion import Motion
from place_recognition.image_processing.local_features import FeatureCache, LocalFeatures
from place_recognition.recognizer import Belief, StageScores
from slam.frame_record import FrameRecord, LoopRecord
from slam.loop_closing.loop_closer import FrameLandmarks, LoopClosure, Rejection
from slam.map_database.inter_session_loops import (
    SessionFeatures,
    SessionLoopCloser,
    SessionRecognizer,
    SessionStart,
    belief_in_session,
    frame_in_session,
    loop_in_map,
    loop_in_session,
)
from slam.map_database.records import loop_row, read_loop
from slam.system import LoopCandidate

FIRST = 40  # number of the first image of the session
START = SessionStart(FIRST, 1000.0)
IMAGE = np.zeros((2, 3), np.uint8)
_ONES = np.ones(1, np.float32)
FEATURES = LocalFeatures(np.ones((1, 2), np.float32), _ONES, _ONES, np.ones((1, 8), np.float32))
NOTHING = FrameLandmarks(
    np.empty((0, 2), np.float32), np.empty((0, 3), np.float32), np.empty(0, np.uint8), np.empty((0, 8), np.float16)
)


def closure(query: int, match: int) -> LoopClosure:
    return LoopClosure(query, match, np.eye(4), np.eye(6), inliers=40, matches=60)


class MapRecognizer:
    """Answers with given beliefs, and keeps what it was asked."""

    def __init__(self, *beliefs: Belief) -> None:
        self.beliefs, self.asked = list(beliefs), []

    def observe(self, image_id: int, image: np.ndarray, travelled: float) -> list[Belief]:
        self.asked.append((image_id, travelled))
        return self.beliefs

    def finish(self) -> list[Belief]:
        return self.beliefs

    def state(self) -> dict:
        return {"asked": list(self.asked)}

    def restore(self, state: dict) -> None:
        self.asked = state["asked"]


class MapLoopCloser:
    """Verifies every loop but those with image 13, and keeps what it was asked."""

    def __init__(self) -> None:
        self.asked: list[tuple[int, ...]] = []

    def extract_landmarks(
        self, index: int, features: LocalFeatures, left: np.ndarray, right: np.ndarray | None
    ) -> FrameLandmarks:
        self.asked.append((index,))
        return NOTHING

    def add_frame(self, index: int, landmarks: FrameLandmarks) -> None:
        self.asked.append((index,))

    def verify(self, query: int, match: int) -> LoopClosure | Rejection:
        self.asked.append((query, match))
        return Rejection("13 is bad luck") if match == 13 else closure(query, match)


def observed(*beliefs: Belief) -> tuple[list[Belief], SessionRecognizer, MapLoopCloser]:
    closer = MapLoopCloser()
    recognizer = SessionRecognizer(MapRecognizer(*beliefs), closer, START)
    return recognizer.observe(7, IMAGE, 2.5), recognizer, closer


def test_the_recogniser_of_the_map_counts_all_images_and_all_of_the_path():
    inner = MapRecognizer()
    SessionRecognizer(inner, MapLoopCloser(), START).observe(7, IMAGE, 2.5)
    assert inner.asked == [(47, 1002.5)]


def test_a_match_in_the_session_has_the_numbers_of_the_session():
    beliefs, recognizer, closer = observed(Belief(46, 42, 9.0, accepted=True))
    assert beliefs == [Belief(6, 2, 9.0, accepted=True)]
    assert closer.asked == []  # the system verifies it
    assert recognizer.take_inter_session(46) is None


def test_a_match_with_an_earlier_session_is_verified_and_collected():
    belief = Belief(46, 12, 9.0, accepted=True)
    beliefs, recognizer, closer = observed(belief)
    assert beliefs == [Belief(6, None, 0.0, accepted=False)]
    assert closer.asked == [(46, 12)]
    record = recognizer.take_inter_session(46)
    assert record is not None
    assert record.belief is belief
    assert isinstance(record.geometry, LoopClosure)
    assert (record.geometry.query, record.geometry.match) == (46, 12)
    assert recognizer.take_inter_session(46) is None  # once


def test_a_match_that_was_not_accepted_is_not_verified_and_one_that_fails_says_why():
    beliefs, recognizer, closer = observed(Belief(45, 12, 2.0, accepted=False), Belief(46, 13, 9.0, accepted=True))
    assert [belief.match for belief in beliefs] == [None, None]
    assert closer.asked == [(46, 13)]
    assert recognizer.take_inter_session(45).geometry is None
    assert recognizer.take_inter_session(46).geometry.reason == "13 is bad luck"


@pytest.mark.parametrize("match", [None, 5, 38])
def test_late_answers_about_the_session_before_are_left_out(match: int | None):
    beliefs, recognizer, closer = observed(Belief(39, match, 1.0, accepted=match is not None))
    assert beliefs == []
    assert closer.asked == []
    assert recognizer.take_inter_session(39) is None


def test_the_loop_closer_of_the_map_counts_all_images():
    inner = MapLoopCloser()
    closer = SessionLoopCloser(inner, FIRST)
    assert closer.extract_landmarks(3, FEATURES, IMAGE, None) is NOTHING
    closer.add_frame(-40, NOTHING)  # the first image of the map
    loop = closer.verify(9, 2)
    assert inner.asked == [(43,), (0,), (49, 42)]
    assert isinstance(loop, LoopClosure)
    assert (loop.query, loop.match) == (9, 2)


def test_records_come_back_from_the_map_in_the_numbers_of_the_session():
    motion = Motion(np.eye(4), np.eye(6), False, "")
    frame = FrameRecord(43, 0.1, motion, np.eye(4), np.eye(4), NOTHING, True, {})
    assert frame_in_session(frame, FIRST).image == 3
    within = LoopRecord(50, Belief(49, 42, 9.0, accepted=True), closure(49, 42))
    back = loop_in_session(within, FIRST)
    assert (back.at_image, back.belief.query, back.belief.match) == (10, 9, 2)
    assert (back.geometry.query, back.geometry.match) == (9, 2)
    across = loop_in_session(LoopRecord(None, Belief(49, 5, 9.0, accepted=True), closure(49, 5)), FIRST)
    assert (across.at_image, across.geometry) == (None, None)
    assert across.belief == Belief(9, None, 0.0, accepted=False)


@pytest.mark.parametrize("geometry", [None, Rejection("no"), closure(9, 2)])
@pytest.mark.parametrize("first", [0, FIRST])
def test_a_loop_is_written_into_the_map_and_restored(geometry: LoopClosure | Rejection | None, first: int):
    stages = StageScores((2, 5), 0.5, 2, 9.0)
    belief = Belief(9, 2, 4.0, accepted=geometry is not None, probability=0.5, stages=stages, answered_at=11)
    candidate = LoopCandidate(belief, geometry, None)
    record = loop_in_map(candidate, first + 11, first)
    back = loop_in_session(record, first)
    assert back.belief == candidate.belief
    assert back.at_image == 11
    assert type(back.geometry) is type(geometry)
    if isinstance(geometry, LoopClosure):
        assert (record.geometry.query, record.geometry.match) == (first + 9, first + 2)
        assert (back.geometry.query, back.geometry.match) == (9, 2)


def test_the_stages_of_a_belief_count_the_images_of_the_session():
    stages = StageScores((45, 12, 41), 0.5, 12, 9.0)
    belief = Belief(49, 42, 9.0, accepted=True, probability=0.9, stages=stages, answered_at=52)
    inside = belief_in_session(belief, FIRST)
    assert inside.stages == StageScores((5, 1), 0.5, None, None)
    assert (inside.answered_at, inside.probability) == (12, 0.9)
    across = belief_in_session(Belief(49, 5, 9.0, accepted=True, probability=0.9, stages=stages, answered_at=52), FIRST)
    assert across == Belief(9, None, 0.0, accepted=False, stages=inside.stages, answered_at=12)
    first_elsewhere = belief_in_session(Belief(49, 42, 9.0, True, stages=StageScores((3, 41), 0.5)), FIRST)
    assert first_elsewhere.stages == StageScores((1,), None)


def test_the_stages_of_a_belief_are_kept_in_the_map():
    stages = StageScores((np.int64(4), 2), np.float32(0.5), np.int64(2), 9.0)
    belief = Belief(9, 2, 4.0, False, probability=np.float64(0.25), stages=stages, answered_at=np.int64(12))
    row = loop_row(0, LoopRecord(11, belief, None))
    assert read_loop(row).belief == belief


def test_a_belief_without_a_match_stays_without_one():
    assert belief_in_session(Belief(41, None, 0.0, accepted=False), FIRST) == Belief(1, None, 0.0, accepted=False)


class NoExtractor:
    """An extractor that must not be asked."""

    kind = "none-8"

    def extract(self, image: np.ndarray, mask: np.ndarray | None = None) -> LocalFeatures:
        raise AssertionError("the features are in the cache")


def test_the_feature_cache_of_the_map_counts_all_images():
    cache = FeatureCache(NoExtractor())
    session = SessionFeatures(cache, FIRST)
    session.put(3, FEATURES)
    assert cache.get(43, IMAGE) is FEATURES
    assert session.get(3, IMAGE) is FEATURES
    assert (session.kind, session.extractor) == (cache.kind, cache.extractor)
