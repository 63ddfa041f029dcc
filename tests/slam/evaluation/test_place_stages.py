"""Stages, events, delays and probabilities as they stand in metrics.json, beside the control."""

import json

import numpy as np
import pytest

from place_recognition.recognizer import Belief, StageScores
from slam.evaluation.place_metrics import (
    INTERVALS,
    NO_CONTROL,
    STAGE_NAMES,
    DriveData,
    PlaceMetrics,
    compare_with_control,
    evaluate_places,
)
from slam.io.metrics import metrics_text

LAP = 200
TRUTH = np.eye(2 * LAP, k=-LAP) > 0
TIMES = 0.1 * np.arange(2 * LAP)
PATH = 1.5 * np.arange(2 * LAP)


def answers(share: float, seed: int = 0, lag: int = 4, probability: float | None = None) -> list[Belief]:
    """Each stage of each query is right with a probability, and the better the score, the likelier it is so."""
    rng = np.random.default_rng(seed)
    found = []
    for query in range(1, 2 * LAP):
        true = query - LAP if query >= LAP else None
        right = rng.random() < share and true is not None
        match = true if right else int(rng.integers(query))
        score = float(rng.random() + (1.0 if right else 0.0))
        stages = StageScores((match,), score, match, 10 * score)
        found.append(Belief(query, match, score, bool(right), 40, True, probability=probability, stages=stages,
                            answered_at=min(query + lag, 2 * LAP - 1)))  # fmt: skip
    return found


def places(beliefs: list[Belief], control: list[Belief] | None = None, drive: DriveData | None = None) -> PlaceMetrics:
    return evaluate_places("p", beliefs, TRUTH, drive=drive, control=control)


def test_the_keys_are_those_of_the_documentation():
    section = places(answers(0.9, probability=0.5), answers(0.1, seed=1)).section
    curve = {"recall_at_100_precision", "area_under_curve", "average_precision"}
    assert tuple(section["stages"]) == STAGE_NAMES == ("candidates", "own", "geometry", "temporal")
    assert set(section["control"]) == {"what", *STAGE_NAMES}
    for part in (section["stages"], section["control"]):
        for stage in STAGE_NAMES:
            values = {"recall_at_1", "recall_at_5", "recall_at_10"} if stage == "candidates" else curve
            assert set(part[stage]) == {*values, INTERVALS, "tolerance_10"}
            assert set(part[stage][INTERVALS]) == set(part[stage]["tolerance_10"]) == values
    json.loads(metrics_text({"places": section}))


def test_the_last_stage_has_the_values_of_the_section():
    section = places(answers(0.6)).section
    for name in ("recall_at_100_precision", "average_precision"):
        assert section["stages"]["temporal"][name] == section[name]
        assert section["stages"]["temporal"]["tolerance_10"][name] == section["tolerance_10"][name]
        low, high = section["stages"]["temporal"][INTERVALS][name]
        assert low <= section[name] <= high


def test_a_stage_as_good_as_random_images_says_so_and_a_better_one_does_not():
    result = places(answers(0.9), answers(0.05, seed=1))
    assert not [note for note in result.notes.values() if "no better" in note]
    result = places(answers(0.5), answers(0.5, seed=1))
    assert {key for key, note in result.notes.items() if "no better than random images" in note} == {
        f"places.stages.{stage}" for stage in STAGE_NAMES
    }
    note = result.notes["places.stages.candidates"]
    assert f"recall_at_10 {result.section['stages']['candidates']['recall_at_10']:.3f} (95 %: " in note
    assert note.endswith(f"against {result.section['control']['candidates']['recall_at_10']:.3f}")


def stage(value: float, low: float, **more: float) -> dict:
    values = dict.fromkeys(("recall_at_10", "average_precision", "recall_at_100_precision"), value) | more
    return values | {INTERVALS: {name: [low, 1.0] for name in values}}


def test_the_lower_end_of_the_interval_decides():
    ours, theirs = (dict.fromkeys(STAGE_NAMES, stage(value, low)) for value, low in ((0.8, 0.6), (0.5, 0.4)))
    assert compare_with_control(ours, theirs) == {}
    at_the_edge = dict.fromkeys(STAGE_NAMES, stage(0.6, 0.5))
    assert set(compare_with_control(ours, at_the_edge)) == set(STAGE_NAMES)
    one_of_two = dict.fromkeys(STAGE_NAMES, stage(0.5, 0.4, recall_at_100_precision=0.7))
    assert set(compare_with_control(ours, one_of_two)) == {"temporal"}
    assert compare_with_control(dict.fromkeys(STAGE_NAMES), theirs) == {}


def test_without_a_control_the_reason_is_given():
    result = places(answers(0.9))
    assert result.section["control"] is None
    assert result.notes["places.control"] == NO_CONTROL
    assert result.control is None


def test_events_are_found_after_images_and_metres():
    beliefs = [b if b.query >= LAP + 7 else Belief(b.query, None, 0.0, False) for b in answers(1.0, lag=3)]
    events = places(beliefs, drive=DriveData(TIMES, PATH)).section["events"]
    assert (events["count"], events["found"], events["recall"]) == (1, 1, 1.0)
    assert events["first_match_frames"] == {"median": 7.0, "max": 7.0}
    assert events["first_match_m"] == {"median": 10.5, "max": 10.5}
    assert events["first_answer_frames"] == {"median": 10.0, "max": 10.0}
    assert events["first_answer_m"]["max"] == pytest.approx(15.0)


def test_what_is_unknown_of_events_is_null_with_a_reason():
    result = places([Belief(b.query, b.match, b.score, b.accepted) for b in answers(1.0)])
    assert result.section["events"]["first_match_m"] is None
    assert result.notes["places.events.first_match_m"] == "the poses are not known"
    assert "does not report" in result.notes["places.events.first_answer_frames"]
    result = places([Belief(3, None, 0.0, False)], drive=DriveData(TIMES, PATH))
    assert (result.section["events"]["found"], result.section["events"]["recall"]) == (0, 0.0)
    assert result.notes["places.events.first_match_m"] == "no event was found"


def test_answers_come_late_by_images_and_seconds():
    section = places(answers(0.9, lag=4), drive=DriveData(TIMES, None)).section
    assert section["delay_frames"] == {"median": 4.0, "max": 4.0}
    assert section["delay_s"] == {"median": pytest.approx(0.4), "max": pytest.approx(0.4)}
    result = places(answers(0.9))
    assert result.section["delay_s"] is None
    assert result.notes["places.delay_s"] == "the recording has no times"


def test_delays_need_no_ground_truth():
    result = evaluate_places("p", answers(0.9), None, drive=DriveData(TIMES, None))
    assert result.section["delay_frames"] == {"median": 4.0, "max": 4.0}
    assert result.section["stages"] == dict.fromkeys(STAGE_NAMES)
    assert result.notes["places.stages.own"] == "there is no ground truth"


def test_probabilities_are_measured_where_there_are_some():
    section = places(answers(0.9, probability=0.9995)).section["probability"]
    right = sum(b.accepted for b in answers(0.9)) / (2 * LAP - 1)
    assert section["expected_calibration_error"] == pytest.approx(0.9995 - right)
    assert (section["sure_probability"], section["sure_matches"]) == (0.999, 2 * LAP - 1)
    assert section["sure_false"] == 2 * LAP - 1 - round(right * (2 * LAP - 1))
    assert [bin_["count"] for bin_ in section["bins"]] == [2 * LAP - 1]
    assert section["tolerance_10"]["sure_false"] <= section["sure_false"]
    result = places(answers(0.9))
    assert result.section["probability"] is None
    assert result.notes["places.probability"] == "the recogniser computes no probabilities"
