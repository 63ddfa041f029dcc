"""Each belief has one row, and the row says what became of it."""

from dataclasses import replace

import numpy as np
import pytest

from odometry import se3
from place_recognition.recognizer import Belief
from slam.loop_closing.loop_closer import LoopClosure, Rejection
from slam.pipeline.loop_log import (
    PoseLoopTruth,
    UnknownLoopTruth,
    event_rows,
    loop_rows,
    matched_pixels,
    stage_rows,
)
from slam.pose_graph.online_loop_selection import LoopDecision, LoopEvent
from slam.pose_graph.robust.backends import GateResult, OptimizationResult
from slam.run_result import LoopEventRow, LoopRow
from slam.system import LoopCandidate

GATE = GateResult(True, 0.5, "drift explains it")
PASSED = LoopDecision(True, True, 0.5, "drift explains it")


def closure(query: int, match: int) -> LoopClosure:
    return LoopClosure(query, match, np.eye(4), np.eye(6), inliers=40, matches=60)


def optimized(*kept: bool) -> OptimizationResult:
    decisions = np.array(kept, dtype=bool)
    reasons = tuple("kept" if keep else "left out" for keep in kept)
    residuals = np.full(len(kept), 1.5)
    return OptimizationResult(
        np.eye(4)[None], decisions * 1.0, residuals, decisions, reasons, 2.0, 1.0, 0.1, np.ones(1)
    )


def log_rows(*candidates: LoopCandidate, kept: tuple[bool, ...] = ()) -> tuple[LoopRow, ...]:
    return loop_rows(candidates, optimized(*kept), UnknownLoopTruth())


def test_a_belief_without_a_match_has_no_row():
    assert log_rows(LoopCandidate(Belief(3, None, 0.0, False), None, None)) == ()


def test_a_belief_that_was_not_accepted_says_why():
    (low,) = log_rows(LoopCandidate(Belief(9, 1, 2.5, False), None, None))
    (unverified,) = log_rows(LoopCandidate(Belief(9, 1, 20.0, False, inliers=5, verified=False), None, None))
    assert low.reason == "not accepted: score 2.5 is below the recogniser's threshold"
    assert unverified.reason == "not accepted: 5 matches agree with one epipolar geometry, too few"


def test_the_row_of_a_rejection_has_its_numbers_and_its_reason():
    (row,) = log_rows(LoopCandidate(Belief(9, 1, 20.0, True), Rejection("too far", 12, 7), None))
    assert (row.matches, row.inliers, row.verified, row.reason) == (12, 7, False, "too far")


def test_each_closure_has_its_own_decision_though_others_failed_in_between():
    rows = log_rows(
        LoopCandidate(Belief(8, 1, 20.0, True), closure(8, 1), PASSED),
        LoopCandidate(Belief(9, 2, 20.0, True), Rejection("no"), None),
        LoopCandidate(Belief(10, 3, 20.0, True), closure(10, 3), PASSED),
        kept=(False, True),
    )
    assert [row.in_graph for row in rows] == [False, False, True]
    assert [row.reason for row in rows] == ["left out", "no", "kept"]
    assert all(row.verified == (row.query != 9) for row in rows)


def test_rows_are_sorted_by_query_also_where_answers_come_late():
    late, early = Belief(4, 0, 1.0, False), Belief(9, 1, 1.0, False)
    assert [row.query for row in log_rows(LoopCandidate(early, None, None), LoopCandidate(late, None, None))] == [4, 9]


def test_ground_truth_is_compared_with_the_measured_pose_of_a_closure():
    poses = np.tile(np.eye(4), (9, 1, 1))
    poses[8, 2, 3] = 5.0  # the closure says that both cameras are in one place
    truth = PoseLoopTruth(poses, np.ones(9))
    candidate = LoopCandidate(Belief(8, 1, 20.0, True), closure(8, 1), PASSED)
    (row,) = loop_rows([candidate], optimized(True), truth)
    assert row.truth is False
    (refused,) = loop_rows([LoopCandidate(Belief(8, 1, 20.0, True), Rejection("no"), None)], optimized(), truth)
    assert refused.truth is True  # without a relative pose: within 10 m


def test_the_error_of_a_closure_is_what_is_left_between_measured_and_true_pose_in_metres():
    poses = np.tile(np.eye(4), (9, 1, 1))
    poses[8] = se3.exp(np.array([0.0, np.radians(3.0), 0.0, 0.0, 0.0, 0.0]))
    poses[8, :3, 3] = [4.0, 0.0, 2.0]
    measured = np.eye(4)
    measured[0, 3] = 1.0  # in the unit of the match, of which one is 4 m long; that of the query must not matter
    unit_m = np.full(9, 7.0)
    unit_m[1] = 4.0
    candidate = LoopCandidate(Belief(8, 1, 20.0, True), replace(closure(8, 1), T_match_query=measured), PASSED)
    (row,) = stage_rows([candidate], [GATE], PoseLoopTruth(poses, unit_m))
    assert row.translation_error_m == pytest.approx(2.0)
    assert row.rotation_error_deg == pytest.approx(3.0)
    (unknown,) = stage_rows([candidate], [GATE], UnknownLoopTruth())
    assert np.isnan(unknown.translation_error_m)
    assert np.isnan(unknown.rotation_error_deg)


def candidates() -> list[LoopCandidate]:
    return [
        LoopCandidate(Belief(8, 1, 20.0, True, inliers=30), closure(8, 1), PASSED),
        LoopCandidate(Belief(9, 2, 20.0, True), Rejection("no"), None),
        LoopCandidate(Belief(7, 3, 20.0, True), closure(7, 3), PASSED),
    ]


def test_stage_rows_have_the_relative_pose_and_the_gate_of_each_closure():
    late, first, refused = stage_rows(candidates(), [GATE, GATE], UnknownLoopTruth())
    assert [row.query for row in (late, first, refused)] == [7, 8, 9]
    assert first.epipolar_inliers == 30
    assert (first.gate_passed, first.gate_sigma, first.position_sigma_m, first.rotation_deg) == (True, 0.5, 1.0, 0.0)
    assert refused.gate_passed is None
    assert np.isnan(refused.x_m)


def test_events_have_their_loop_and_keep_their_order():
    history = [LoopEvent(8, 0, False, "waits"), LoopEvent(9, 1, True, "joined"), LoopEvent(9, 0, True, "joined")]
    assert event_rows(candidates(), history) == (
        LoopEventRow(7, 3, 9, True, "joined"),
        LoopEventRow(8, 1, 8, False, "waits"),
        LoopEventRow(8, 1, 9, True, "joined"),
    )
    assert event_rows(candidates(), []) == ()


def test_a_belief_without_a_match_has_no_stages():
    assert stage_rows([LoopCandidate(Belief(3, None, 0.0, False), None, None)], [], UnknownLoopTruth()) == ()


def test_matched_pixels_are_those_of_closures_and_rejections_alike():
    here, there = np.float32([[1, 2], [3, 4]]), np.float32([[5, 6], [7, 8]])
    verified = LoopClosure(8, 1, np.eye(4), np.eye(6), 2, 60, here, there)
    candidates = [
        LoopCandidate(Belief(6, None, 0.0, False), None, None),
        LoopCandidate(Belief(7, 0, 1.0, False), None, None),
        LoopCandidate(Belief(8, 1, 20.0, True, pixels=np.hstack([there, here])), verified, PASSED),
        LoopCandidate(Belief(9, 2, 20.0, True), Rejection("no", 30, 2, there, here), None),
    ]
    for geometry in (None, Rejection("no pose", 30)):  # then what the recogniser saw is shown
        candidates.append(LoopCandidate(Belief(10, 3, 1.0, False, pixels=np.hstack([here, there])), geometry, None))
    first, second, *others = matched_pixels(candidates)
    assert (first.query, first.match, second.query, second.match) == (8, 1, 9, 2)
    assert first.pixels_query is second.pixels_match is here
    assert first.pixels_match is second.pixels_query is there
    assert first.agree_with == second.agree_with == "one relative pose"
    assert [other.agree_with for other in others] == ["one epipolar geometry"] * 2
    for other in others:
        np.testing.assert_array_equal(other.pixels_query, here)
        np.testing.assert_array_equal(other.pixels_match, there)
