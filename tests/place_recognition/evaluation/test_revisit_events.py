"""Revisit events: what belongs together, when it was found, and when that was known."""

from pathlib import Path

import numpy as np
import pytest

from place_recognition.evaluation.revisit_ground_truth import (
    MAX_GAP_IMAGES,
    RevisitEvent,
    answer_delays,
    find_revisit_events,
    load_truth,
)
from place_recognition.recognizer import Belief


def truth_of(*queries: int, images: int = 200) -> np.ndarray:
    truth = np.zeros((images, images), bool)
    truth[list(queries), 5] = True
    return truth


def spans(truth: np.ndarray) -> list[tuple[int, int]]:
    return [(event.first, event.last) for event in find_revisit_events([], truth)]


def test_a_short_hole_stays_inside_an_event_and_a_longer_one_ends_it():
    first = list(range(50, 60))
    inside, outside = 60 + MAX_GAP_IMAGES, 61 + MAX_GAP_IMAGES  # so many images without truth between
    assert spans(truth_of(*first, inside)) == [(50, inside)]
    assert spans(truth_of(*first, outside)) == [(50, 59), (outside, outside)]


def test_a_single_query_is_an_event_and_no_truth_is_none():
    assert spans(truth_of(7)) == [(7, 7)]
    assert spans(np.zeros((9, 9), bool)) == []


def test_the_first_accepted_true_match_is_the_detection():
    beliefs = [
        Belief(50, 5, 1.0, accepted=False),
        Belief(51, 6, 9.0, accepted=True),  # another place
        Belief(52, 5, 3.0, accepted=True, answered_at=70),
        Belief(53, 5, 8.0, accepted=True, answered_at=60),  # known before the one above
        Belief(150, 5, 8.0, accepted=False, answered_at=150),
    ]
    events = find_revisit_events(beliefs[::-1], truth_of(*range(50, 60), *range(150, 160)))
    assert events == (RevisitEvent(50, 59, 52, 60), RevisitEvent(150, 159, None, None))


def test_the_detection_of_one_event_is_not_that_of_another():
    events = find_revisit_events(
        [Belief(153, 5, 8.0, accepted=True, answered_at=153)], truth_of(*range(50, 60), *range(150, 160))
    )
    assert [event.detected for event in events] == [None, 153]


def test_the_tolerance_is_that_of_a_match():
    beliefs = [Belief(50, 9, 1.0, accepted=True)]
    truth = truth_of(50, 51)
    assert find_revisit_events(beliefs, truth)[0].detected is None
    assert find_revisit_events(beliefs, truth, tolerance=4)[0] == RevisitEvent(50, 51, 50, None)


@pytest.mark.parametrize("query", [49, 60, 70])
def test_a_match_outside_an_event_does_not_find_it(query: int):
    events = find_revisit_events([Belief(query, 5, 1.0, accepted=True)], truth_of(*range(50, 60)))
    assert events[0].detected is None


def test_delays_are_of_the_answers_that_say_when_they_came():
    beliefs = [
        Belief(3, None, 0.0, False, answered_at=8),
        Belief(4, 1, 2.0, True),
        Belief(5, 1, 2.0, True, answered_at=5),
    ]
    assert answer_delays(beliefs).tolist() == [[3, 8], [5, 5]]
    assert answer_delays([]).shape == (0, 2)


@pytest.mark.parametrize(
    ("name", "events"), [("KITTI00", 6), ("KITTI05", 3), ("KITTI06", 1), ("CityCentre", 2), ("NC", 5), ("Malaga6L", 5)]
)
def test_published_matrices_fall_into_the_revisits_that_one_sees(test_data: Path, name: str, events: int):
    truth = load_truth(test_data / "loop_ground_truth" / f"groundTruth{name}.mat")
    assert len(find_revisit_events([], truth)) == events
