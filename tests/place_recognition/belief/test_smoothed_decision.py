"""From verified candidates to beliefs: a street of landmarks, driven twice, with stops and from other sides."""

import copy
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from landmark_street import LandmarkStreet, View, history_of, no_features

from place_recognition.belief.decisions import SmoothedDecision, min_evidence, stage_scores
from place_recognition.belief.likelihood_ratios import RatioTable
from place_recognition.belief.place_filter import PlaceFilterConfig
from place_recognition.recognizer import Proposals, select_apart
from place_recognition.verification.candidate_verification import (
    CandidateVerificationConfig,
    VerificationResult,
    verify_candidates,
)

NO_SCORE = RatioTable((0.0,), (0.0,))
STREET, OTHER_STREET = LandmarkStreet(seed=1), LandmarkStreet(seed=2)
CONFIG = CandidateVerificationConfig()
POOL = ThreadPoolExecutor(2)


class Drive:
    """A drive along one street, then another, then the first again; candidates are the images that share most."""

    def __init__(
        self, first_m, second_m, x_m: float = 0.4, mirrored: bool = False, blank: tuple[int, ...] = ()
    ) -> None:
        away = [OTHER_STREET.view(z) for z in np.arange(0, 60, 1.0)]
        again = [STREET.view(z, x_m, mirrored) for z in second_m]
        self.positions_m = np.concatenate([first_m, np.full(len(away), np.nan), second_m])
        self.second = len(first_m) + len(away)
        self.views = [STREET.view(z) for z in first_m] + away + again
        for k in blank:
            self.views[k] = View(no_features(), np.empty(0, np.int64))
        self.history = history_of([view.features for view in self.views])

    def is_in_street(self, query: int) -> bool:
        return not np.isnan(self.positions_m[query])

    def proposals(self, query: int) -> Proposals:
        last = query - 50
        away = not self.is_in_street(query)
        shared = [
            0 if away != (not self.is_in_street(k)) else len(np.intersect1d(self.landmarks(query), self.landmarks(k)))
            for k in range(last + 1)
        ]
        order = np.argsort(-np.array(shared), kind="stable").tolist()
        chosen = tuple(order[k] for k in select_apart(order, 3, 4))
        return Proposals(query, max(last, -1), chosen, (0.0,) * len(chosen))

    def landmarks(self, k: int) -> np.ndarray:
        return self.views[k].landmarks

    def decide(self, config: PlaceFilterConfig | None = None, stop: int | None = None):
        """Beliefs about all images, and the number of beliefs after each image; restored once at `stop`."""
        decision, beliefs, counts = self.make(config), [], []
        for query in range(len(self.views)):
            if query == stop:
                restored = self.make(config)
                restored.restore(copy.deepcopy(decision.state()))
                decision = restored
            proposals = self.proposals(query)
            results = verify_candidates(
                self.history.images, query, proposals.locations, proposals.last_matchable, CONFIG, POOL
            )
            beliefs += decision.add(proposals, results)
            counts.append(len(beliefs))
        return beliefs + decision.finish(), counts

    def make(self, config: PlaceFilterConfig | None = None) -> SmoothedDecision:
        return SmoothedDecision(self.history, NO_SCORE, config or PlaceFilterConfig(), CONFIG)

    def errors_m(self, beliefs) -> np.ndarray:
        """Distance of each match of the second pass from its query along the street; NaN where none is accepted."""
        return np.array(
            [
                abs(self.positions_m[b.match] - self.positions_m[b.query]) if b.accepted else np.nan
                for b in beliefs[self.second :]
            ]
        )


STEADY = np.arange(0, 80, 1.0)
WITH_STOP = np.concatenate([np.arange(0, 40, 1.0), np.full(30, 40.0), np.arange(40, 80, 1.0)])


@pytest.fixture(scope="module")
def steady():
    return Drive(STEADY, STEADY)


@pytest.fixture(scope="module")
def decided(steady):
    return steady.decide()


def check_second_pass_is_recognised(drive: Drive, beliefs) -> None:
    errors_m = drive.errors_m(beliefs)
    assert not any(belief.accepted for belief in beliefs[: drive.second])
    assert np.mean(~np.isnan(errors_m)) > 0.85
    assert np.nanmax(errors_m) <= 6
    assert np.nanmedian(errors_m) <= 1


def test_a_second_pass_is_recognised(steady, decided):
    check_second_pass_is_recognised(steady, decided[0])


@pytest.mark.parametrize(
    ("first_m", "second_m"),
    [(WITH_STOP, STEADY), (STEADY, WITH_STOP), (WITH_STOP, WITH_STOP)],
    ids=["in the first", "in the second", "in both"],
)
def test_a_stop_in_a_pass_does_not_break_the_revisit(first_m, second_m):
    drive = Drive(first_m, second_m)
    check_second_pass_is_recognised(drive, drive.decide()[0])


def test_a_pass_at_twice_the_speed_is_recognised():
    drive = Drive(STEADY, np.arange(0, 80, 2.0))
    errors_m = drive.errors_m(drive.decide()[0])
    assert np.mean(~np.isnan(errors_m)) > 0.7
    assert np.nanmax(errors_m) <= 6


def test_a_mirrored_street_is_not_the_street():
    drive = Drive(STEADY, STEADY, mirrored=True)
    assert not any(belief.accepted for belief in drive.decide()[0])


def test_every_query_is_answered_once_in_order_and_lag_images_late(steady, decided):
    beliefs, counts = decided
    lag = PlaceFilterConfig().lag_frames
    assert [belief.query for belief in beliefs] == list(range(len(steady.views)))
    assert counts == [max(k + 1 - lag, 0) for k in range(len(steady.views))]


def test_without_a_lag_the_answer_comes_at_once_and_less_is_accepted(steady, decided):
    beliefs, counts = steady.decide(PlaceFilterConfig(lag_frames=0))
    assert counts == [k + 1 for k in range(len(steady.views))]
    assert 0 < sum(b.accepted for b in beliefs) <= sum(b.accepted for b in decided[0])


def test_a_restored_decision_goes_on_with_the_same_beliefs(steady, decided):
    again, _ = steady.decide(stop=steady.second + 20)
    assert again == decided[0]
    assert all(np.array_equal(a.pixels, b.pixels) for a, b in zip(again, decided[0], strict=True))


def test_an_accepted_match_is_probable_and_verified_by_geometry(decided):
    for belief in decided[0]:
        assert 0.0 <= belief.probability <= 1.0
        if belief.accepted:
            assert belief.probability >= PlaceFilterConfig().min_probability
            assert belief.verified
            assert belief.inliers == len(belief.pixels) > 0


def test_a_probable_match_whose_own_geometry_is_weak_is_not_accepted(steady):
    """The images around one query of the second pass make its place certain; its own pair does not."""
    weak, decision, beliefs = steady.second + 40, steady.make(), []
    for query in range(len(steady.views)):
        inliers, evidence = (14, 0.5) if query == weak else (60, 50.0)
        location = query - steady.second
        results = (VerificationResult(query, location, inliers, evidence),) if location >= 0 else ()
        proposed = tuple(result.location for result in results)
        beliefs += decision.add(Proposals(query, query - 50, proposed, (0.0,) * len(proposed)), results)
    beliefs += decision.finish()
    assert beliefs[weak].match == 40
    assert beliefs[weak].probability >= PlaceFilterConfig().min_probability
    assert not beliefs[weak].verified
    assert not beliefs[weak].accepted
    assert beliefs[weak - 1].accepted
    assert beliefs[weak + 1].accepted


def test_a_larger_smallest_probability_accepts_no_more(steady, decided):
    strict, _ = steady.decide(PlaceFilterConfig(min_probability=0.99999))
    accepted = {b.query for b in decided[0] if b.accepted}
    assert {b.query for b in strict if b.accepted} < accepted


def test_a_match_is_never_later_than_the_last_matchable_location(steady, decided):
    assert all(b.match is None or b.match <= b.query - 50 for b in decided[0])


def test_blank_images_match_nothing_and_are_not_matched():
    drive = Drive(STEADY, STEADY, blank=(30, 170))
    beliefs, _ = drive.decide()
    assert beliefs[170].match is None
    assert not beliefs[170].accepted
    assert all(b.match != 30 for b in beliefs)
    assert beliefs[169].accepted
    assert beliefs[171].accepted


def test_the_same_evidence_off_any_line_is_not_accepted(steady):
    """Each query of the second pass agrees with some place, but every time with another one."""
    rng, decision, beliefs = np.random.default_rng(0), steady.make(), []
    for query in range(len(steady.views)):
        location = int(rng.integers(80))
        result = VerificationResult(query, location, 40, 30.0)
        candidates = (location,) if query >= steady.second else ()
        beliefs += decision.add(
            Proposals(query, query - 50, candidates, (0.0,) * len(candidates)), (result,) * len(candidates)
        )
    assert not any(belief.accepted for belief in beliefs + decision.finish())


def test_the_stages_are_what_the_paradigm_and_geometry_say_by_themselves(steady):
    results = (VerificationResult(150, 7, 20, 12.0), VerificationResult(150, 9, 30, 25.0))
    stages = stage_scores(steady.history, Proposals(150, 100, (7, 40, 9), (3.0, 2.0, 1.0)), results)
    assert (stages.candidates, stages.own_score) == ((7, 40, 9), 3.0)
    assert (stages.geometry_match, stages.geometry_score) == (9, 25.0)
    nothing = stage_scores(steady.history, Proposals(150, 100, (7,), (3.0,)), (VerificationResult(150, 7, 0, 0.0),))
    assert (nothing.geometry_match, nothing.geometry_score) == (None, None)
    empty = stage_scores(steady.history, Proposals(150, 100), ())
    assert (empty.candidates, empty.own_score, empty.geometry_match) == ((), None, None)


def test_the_evidence_that_verifies_grows_with_the_drive():
    assert min_evidence(9, CONFIG) == pytest.approx(np.log10(10 * CONFIG.max_candidates))
    assert min_evidence(10**6, CONFIG) > min_evidence(10**3, CONFIG) + 2.9
