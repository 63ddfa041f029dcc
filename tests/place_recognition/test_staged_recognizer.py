"""The stages lose no image, answer in time and in order, and match nothing that is still in view."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from landmark_street import LandmarkStreet
from place_images import CachingSurf, two_laps

from place_recognition import staged_recognizer
from place_recognition.belief.decisions import SmoothedDecision
from place_recognition.belief.likelihood_ratios import RatioTable
from place_recognition.belief.place_filter import PlaceFilterConfig
from place_recognition.image_processing.local_features import FeatureCache
from place_recognition.map.image_history import ImageHistory
from place_recognition.paradigms.registry import ParadigmsConfig, make_control, make_recognizer
from place_recognition.recognizer import (
    ObservedImage,
    Proposals,
    RandomImages,
    can_forget,
    propose_best,
    select_apart,
)
from place_recognition.staged_recognizer import RowsById, StagedRecognizer
from place_recognition.verification.candidate_verification import CandidateVerificationConfig
from place_recognition.verification.present_view import PresentView

LAG = 4
POSITIONS_M = np.concatenate([np.arange(0, 120, 4.0), np.arange(0, 120, 4.0)])
STREET = LandmarkStreet(length_m=160.0)
FEATURES = [STREET.view(z).features for z in POSITIONS_M]


class StreetFeatures:
    """Extracts the features of the street from an image that holds nothing but its number."""

    kind = "landmarks"

    def extract(self, image):
        return FEATURES[int(image[0, 0])]


def image_of(k: int) -> np.ndarray:
    return np.full((2, 2), k, np.uint8)


class BurstProposer:
    """Proposes the image one lap before, where it may; answers for several images at once (a Proposer)."""

    def __init__(self, bursts):
        self._bursts, self._waiting, self.seen = list(bursts), [], []

    def observe(self, image: ObservedImage) -> list[Proposals]:
        self.seen.append(image)
        location = image.location - len(POSITIONS_M) // 2
        candidates = (location,) if 0 <= location <= image.last_matchable else ()
        self._waiting.append(Proposals(image.location, image.last_matchable, candidates, (1.0,) * len(candidates)))
        size = self._bursts[len(self.seen) % len(self._bursts)]
        return self._flush() if len(self._waiting) >= size else []

    def finish(self):
        return self._flush()

    def _flush(self):
        ready, self._waiting = self._waiting, []
        return ready

    def state(self):
        return {}

    def restore(self, state):
        pass


def drive(proposer, id_step=1):
    """Beliefs of both laps, and after each image how many there were."""
    history, verification = ImageHistory(), CandidateVerificationConfig()
    decision = SmoothedDecision(history, RatioTable((0.0,), (0.0,)), PlaceFilterConfig(lag_frames=LAG), verification)
    features, view = FeatureCache(StreetFeatures()), PresentView(history)
    recognizer = StagedRecognizer(features, history, view, proposer, decision, verification)
    beliefs, counts = [], []
    for k in range(len(POSITIONS_M)):
        now = recognizer.observe(id_step * k, image_of(k), float("nan"))
        assert all(belief.answered_at == id_step * k for belief in now)
        beliefs += now
        counts.append(len(beliefs))
    rest = recognizer.finish()
    assert all(belief.answered_at == id_step * (len(POSITIONS_M) - 1) for belief in rest)
    return beliefs + rest, counts


@settings(max_examples=12, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(st.integers(1, 12), min_size=1, max_size=5))
def test_each_image_is_answered_once_in_order_and_in_time_however_a_paradigm_bursts(bursts):
    beliefs, counts = drive(BurstProposer(bursts))
    assert [belief.query for belief in beliefs] == list(range(len(POSITIONS_M)))
    # A burst of n is complete n - 1 images after its first one; two are verified at a time while more than 6 wait.
    longest, waiting = max(bursts), staged_recognizer._MAX_WAITING
    assert all(count >= k + 1 - LAG - longest - -(-longest // 2) - waiting for k, count in enumerate(counts))


@pytest.mark.parametrize("burst", [2, 7, 20])
def test_spreading_a_burst_over_the_images_that_follow_changes_no_belief(burst, monkeypatch):
    spread, _ = drive(BurstProposer([burst]))
    monkeypatch.setattr(staged_recognizer, "_count_now", lambda waiting: waiting)
    at_once, _ = drive(BurstProposer([burst]))
    assert [replace(b, answered_at=None) for b in spread] == [replace(b, answered_at=None) for b in at_once]
    late = [b.answered_at - c.answered_at for b, c in zip(spread, at_once, strict=True)]
    assert min(late) >= 0
    assert max(late) > 0
    single, _ = drive(BurstProposer([1]))
    assert [b.match for b in spread] == [b.match for b in single]
    assert sum(b.accepted for b in spread) > 15


def test_no_more_proposals_are_verified_with_one_image_than_allowed(monkeypatch):
    verified = []
    original = staged_recognizer.verify_candidates
    monkeypatch.setattr(
        staged_recognizer, "verify_candidates", lambda *args: verified.append(args[1]) or original(*args)
    )
    proposer, before = BurstProposer([10]), [0]

    def observe(image):
        assert len(verified) - before[0] <= 2
        before[0] = len(verified)
        return BurstProposer.observe(proposer, image)

    monkeypatch.setattr(proposer, "observe", observe, raising=False)
    drive(proposer)
    assert verified == list(range(len(POSITIONS_M)))


def test_beliefs_name_images_by_id_and_say_when_they_were_answered():
    plain, _ = drive(BurstProposer([3]))
    beliefs, _ = drive(BurstProposer([3]), id_step=7)
    assert [b.query for b in beliefs] == [7 * b.query for b in plain]
    assert [b.match for b in beliefs] == [None if b.match is None else 7 * b.match for b in plain]
    assert [b.answered_at for b in beliefs] == [7 * b.answered_at for b in plain]
    assert [b.stages.candidates for b in beliefs] == [tuple(7 * c for c in b.stages.candidates) for b in plain]
    assert all(b.answered_at >= b.query for b in beliefs)


def test_a_match_is_never_later_than_what_was_matchable_when_its_query_came():
    proposer = BurstProposer([6])
    beliefs, _ = drive(proposer)
    matched = [b for b in beliefs if b.match is not None]
    assert matched
    assert all(b.match <= proposer.seen[b.query].last_matchable for b in matched)


def test_a_proposer_sees_each_image_with_its_features_and_what_is_matchable():
    proposer = BurstProposer([1])
    drive(proposer)
    assert [image.location for image in proposer.seen] == list(range(len(POSITIONS_M)))
    assert all(len(image.features) == len(FEATURES[k]) for k, image in enumerate(proposer.seen))
    assert all(-1 <= image.last_matchable < image.location for image in proposer.seen)
    assert proposer.seen[-1].last_matchable > 40


# --- proposals


def test_the_best_proposals_are_apart_and_positive():
    image = ObservedImage(20, image_of(0), FEATURES[0], 0.0, 9)
    similarities = np.array([0.1, 0.9, 0.8, -1.0, 0.7, 0.0, 0.6, 0.95, 0.2, 0.3])
    proposals = propose_best(image, similarities, max_count=3, min_separation=3)
    assert proposals == Proposals(20, 9, (7, 1, 4), (0.95, 0.9, 0.7))
    other = propose_best(image, similarities, 2, 3, scores=10 * similarities)
    assert (other.locations, other.scores) == ((7, 1), (9.5, 9.0))
    assert propose_best(image, np.zeros(5), 3, 3).locations == ()
    assert propose_best(image, np.empty(0), 3, 3).locations == ()


@given(st.lists(st.integers(0, 99), max_size=40, unique=True), st.integers(1, 9), st.integers(1, 9))
def test_chosen_locations_are_apart_and_none_better_is_left_out(locations, max_count, min_separation):
    chosen = [locations[k] for k in select_apart(locations, max_count, min_separation)]
    assert all(abs(a - b) >= min_separation for a in chosen for b in chosen if a != b)
    assert len(chosen) <= max_count
    for location in locations[: locations.index(chosen[-1])] if chosen else []:
        assert location in chosen or any(abs(location - other) < min_separation for other in chosen)


@given(st.integers(0, 2**32 - 1), st.integers(1, 200), st.integers(1, 12), st.integers(1, 6))
def test_the_best_proposals_are_those_of_a_full_sort(seed, count, max_count, min_separation):
    similarities = np.random.default_rng(seed).normal(size=count)
    image = ObservedImage(500, image_of(0), FEATURES[0], 0.0, count - 1)
    order = [int(k) for k in np.argsort(-similarities, kind="stable") if similarities[k] > 0]
    expected = tuple(order[k] for k in select_apart(order, max_count, min_separation))
    assert propose_best(image, similarities, max_count, min_separation).locations == expected


def test_rows_are_handed_on_by_id():
    history, rows = ImageHistory(), []
    for k in range(4):
        history.add(10 * k, FEATURES[k], float("nan"))

    class Sink:
        def add(self, query, matches, values, stage="similarity"):
            rows.append((query, matches.tolist(), values.tolist(), stage))

    RowsById(history, Sink()).add(3, np.array([0, 2]), np.array([0.5, 0.25]), "filtered")
    RowsById(history, None).add(3, np.array([0, 2]), np.array([0.5, 0.25]))
    assert rows == [(30, [0, 20], [0.5, 0.25], "filtered")]


# --- the control


def control_beliefs(seed: int):
    recognizer = make_control(FeatureCache(CachingSurf()), ParadigmsConfig(seed=seed))
    beliefs = [b for i, image in enumerate(two_laps()) for b in recognizer.observe(i, image, float("nan"))]
    return beliefs + recognizer.finish()


def test_the_control_is_the_same_for_the_same_seed_and_another_for_another():
    one, again, other = control_beliefs(1), control_beliefs(1), control_beliefs(2)
    assert one == again
    assert [b.stages.candidates for b in one] != [b.stages.candidates for b in other]


def test_the_control_proposes_any_matchable_image_equally_often_and_no_other():
    counts = np.zeros(50, np.int64)
    for seed in range(200):
        image = ObservedImage(60, image_of(0), FEATURES[0], 0.0, 49)
        [proposals] = RandomImages(seed, max_candidates=10).observe(image)
        assert len(set(proposals.locations)) == 10
        assert set(proposals.scores) == {0.0}
        counts[list(proposals.locations)] += 1
    assert counts.min() > 15
    assert counts.max() < 70  # 40 expected, standard deviation 5.7
    [early] = RandomImages(0).observe(ObservedImage(3, image_of(0), FEATURES[0], 0.0, 1))
    assert sorted(early.locations) == [0, 1]
    [nothing] = RandomImages(0).observe(ObservedImage(3, image_of(0), FEATURES[0], 0.0, -1))
    assert nothing.locations == ()


LAP = len(two_laps()) // 2
STEP_M = 2.0


def drive_laps(laps, max_laps, stop=None, recognizer=None):
    """Observe laps; matched images of later laps than so many are forgotten. Returns recogniser and beliefs."""
    recognizer = recognizer or make_recognizer("tracked-words", FeatureCache(CachingSurf()))
    beliefs = []
    images = two_laps()[:LAP] * laps
    first = len(recognizer._history)
    for k in range(first, len(images) if stop is None else stop):
        for belief in recognizer.observe(k, images[k], STEP_M * k):
            beliefs.append(belief)
            if belief.accepted and belief.query >= max_laps * LAP:
                recognizer.forget(belief.query)
    return recognizer, beliefs


def test_forgotten_images_are_never_matched_and_leave_hardly_anything():
    sizes, matches = {}, {}
    for max_laps in (2, 6):
        recognizer, beliefs = drive_laps(6, max_laps)
        sizes[max_laps] = (
            recognizer.word_count,
            np.count_nonzero([recognizer._history.images.count(k) for k in range(6 * LAP)]),
        )
        matches[max_laps] = [b.match for b in beliefs if b.accepted]
    assert len(matches[2]) >= 0.97 * len(matches[6])
    assert sizes[2][0] < 0.6 * sizes[6][0]
    assert sizes[2][1] < 0.6 * sizes[6][1]
    forgotten = {b.query for b in drive_laps(6, 2)[1] if b.accepted and b.query >= 2 * LAP}
    assert not forgotten & set(matches[2])


def test_a_restored_recogniser_has_forgotten_the_same_images():
    undisturbed, expected = drive_laps(5, 2)
    for stop in (2 * LAP + 25, 4 * LAP + 3):
        stopped, before = drive_laps(5, 2, stop)
        restored = make_recognizer("tracked-words", FeatureCache(CachingSurf()))
        restored.restore(copy.deepcopy(stopped.state()))
        _, after = drive_laps(5, 2, recognizer=restored)
        assert before + after == expected
        assert repr(restored.state()["forgotten"]) == repr(undisturbed.state()["forgotten"])


def test_what_a_recogniser_can_forget_is_said():
    features = FeatureCache(CachingSurf())
    assert can_forget(make_recognizer("tracked-words", features))
    assert not can_forget(make_recognizer("hierarchical-places", features))
    assert not can_forget(make_control(features))
