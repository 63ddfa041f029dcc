"""The contract of every proposer: what it may propose, that it is causal, and that it knows the place."""

import copy

import numpy as np
import pytest
from place_images import LAP_IMAGES, observe_image, observed_images, propose_all, two_laps

from place_recognition.image_processing.surf import Surf
from place_recognition.map.image_history import ImageHistory
from place_recognition.paradigms.registry import PARADIGMS, ParadigmsConfig
from place_recognition.recognizer import (
    MAX_STAGE_CANDIDATES,
    NullMatrixSink,
    ObservedImage,
    Proposals,
    Proposer,
    RandomImages,
)
from place_recognition.staged_recognizer import RowsById

MIN_SEPARATION = 4  # of all paradigms


class WithHistory:
    """A proposer and the history that it reads, which is filled image by image (a Proposer)."""

    def __init__(self, name: str, rows=None) -> None:
        self._history = ImageHistory()
        sink = NullMatrixSink() if rows is None else RowsById(self._history, rows)
        self._proposer: Proposer = PARADIGMS[name](self._history, Surf().kind, ParadigmsConfig(), sink)

    def observe(self, image: ObservedImage) -> list[Proposals]:
        self._history.add(image.location, image.features, image.distance_travelled_m)
        return self._proposer.observe(image)

    def finish(self):
        return self._proposer.finish()

    def state(self):
        return {"history": self._history.state(), "proposer": self._proposer.state()}

    def restore(self, state):
        self._history.restore(state["history"])
        self._proposer.restore(state["proposer"])


def make(name: str) -> Proposer:
    return RandomImages(seed=0) if name == "random-images" else WithHistory(name)


@pytest.fixture(scope="module", params=[*PARADIGMS, "random-images"])
def name(request):
    return request.param


@pytest.fixture(scope="module")
def images():
    return observed_images()


@pytest.fixture(scope="module")
def expected(name, images):
    return propose_all(make(name), images)


def test_each_image_gets_proposals_once_and_in_order(expected, images):
    assert [one.query for one in expected] == list(range(len(images)))


def test_proposals_are_matchable_apart_and_few(name, expected, images):
    for one in expected:
        assert -1 <= one.last_matchable <= images[one.query].last_matchable
        assert all(0 <= location <= one.last_matchable for location in one.locations)
        assert len(set(one.locations)) == len(one.locations) == len(one.scores) <= MAX_STAGE_CANDIDATES
        assert np.isfinite(one.scores).all()
        if name != "random-images":
            gaps = np.diff(np.sort(one.locations))
            assert len(gaps) == 0 or gaps.min() >= MIN_SEPARATION
    assert sum(bool(one.locations) for one in expected) > 0.8 * LAP_IMAGES


def hits_at_first(proposals) -> float:
    """Share of the images of the second lap whose first proposal is within two images of it in the first."""
    second = [one for one in proposals if one.query >= LAP_IMAGES]
    return float(np.mean([bool(p.locations) and abs(p.locations[0] + LAP_IMAGES - p.query) <= 2 for p in second]))


def test_a_paradigm_proposes_the_right_place_first_and_chance_does_not(name, expected):
    """Without geometry and without a decision: the paradigm itself must know."""
    if name == "random-images":
        assert hits_at_first(expected) < 0.3
    else:
        assert hits_at_first(expected) > 0.9


def test_the_score_of_the_right_place_is_higher_than_those_of_a_first_pass(name, expected):
    first = [one.scores[0] for one in expected if one.query < LAP_IMAGES and one.scores]
    second = [one.scores[0] for one in expected if one.query >= LAP_IMAGES + 10 and one.scores]
    if name == "random-images":
        assert {*first, *second} == {0.0}
    else:
        assert np.median(second) > max(first, default=0.0)


def test_two_runs_propose_the_same(name, images, expected):
    assert propose_all(make(name), images) == expected


def test_proposals_do_not_depend_on_later_images(name, images, expected):
    proposer = make(name)
    begun = [one for image in images[:60] for one in proposer.observe(image)]
    assert begun == expected[: len(begun)]


@pytest.mark.parametrize("stop", [0, 1, 33, 57])
def test_a_restored_proposer_goes_on_with_the_same_bits(name, images, expected, stop):
    stopped, restored = make(name), make(name)
    before = [one for image in images[:stop] for one in stopped.observe(image)]
    restored.restore(copy.deepcopy(stopped.state()))
    assert before + propose_all(restored, images[stop:]) == expected


def test_a_blank_image_proposes_nothing_and_the_others_still_do(name, images):
    blank = np.zeros_like(two_laps()[0])
    proposals = propose_all(
        make(name), [observe_image(k, blank) if k == 60 else image for k, image in enumerate(images)]
    )
    if name != "random-images":
        assert proposals[60].locations == ()
        assert hits_at_first(proposals) > 0.8


def test_nothing_is_proposed_where_nothing_is_matchable(name, images):
    young = [ObservedImage(one.location, one.pixels, one.features, one.distance_travelled_m, -1) for one in images]
    assert all(one.locations == () for one in propose_all(make(name), young))
