"""A loop is true when the cameras were there; recall counts revisits that a rule declares."""

from pathlib import Path

import numpy as np
import pytest

from odometry import se3
from place_recognition.evaluation.revisit_ground_truth import PoseTruth, RevisitRule
from slam.evaluation.loops import (
    LoopError,
    LoopRule,
    count_loops,
    find_revisits,
    is_same_place,
    is_true_loop,
    kept_loop_errors,
    loop_error,
    revisit_matrix,
    revisit_truth,
    summarize_loop_errors,
)
from slam.io.trajectory_files import read_kitti
from slam.run_result import LoopRow, StageRow


def circle(radius: float, laps: float, count: int, clockwise: bool = True) -> np.ndarray:
    """Poses (count, 4, 4) on a circle in the x-z plane, looking along it."""
    angles = np.linspace(0.0, 2 * np.pi * laps, count) * (1 if clockwise else -1)
    poses = np.stack([se3.exp(np.array([0.0, angle, 0.0, 0.0, 0.0, 0.0])) for angle in angles])
    centre = np.array([radius if clockwise else -radius, 0.0, 0.0])
    poses[:, :3, 3] = centre - poses[:, :3, :3] @ centre
    return poses


def line(z: np.ndarray, turned: np.ndarray | None = None) -> np.ndarray:
    """Poses on the z axis, turned about y by angles in radians."""
    turned = np.zeros(len(z)) if turned is None else turned
    return np.stack([se3.exp(np.array([0.0, a, 0.0, 0.0, 0.0, 0.0])) for a in turned]) + _at(z)


def _at(z: np.ndarray) -> np.ndarray:
    offsets = np.zeros((len(z), 4, 4))
    offsets[:, 2, 3] = z
    return offsets


def row(query: int, match: int, in_graph: bool = True, **more: object) -> LoopRow:
    return LoopRow(query, match, 1.0, accepted=True, verified=in_graph, in_graph=in_graph, **more)


def test_the_same_place_is_within_ten_metres() -> None:
    truth = line(np.array([0.0, 9.9, 10.1]))
    assert is_same_place(truth, 1, 0)
    assert not is_same_place(truth, 2, 0)
    assert is_same_place(truth, 2, 0, LoopRule(max_distance_m=11.0))


def test_a_measured_loop_must_agree_with_ground_truth() -> None:
    truth = circle(50.0, 2, 201)
    T_match_query = se3.inverse(truth[20]) @ truth[121]
    assert is_true_loop(truth, 121, 20, T_match_query)


@pytest.mark.parametrize(
    ("error", "true"),
    [
        ([0.0, 0.0, 0.0, 2.9, 0.0, 0.0], True),
        ([0.0, 0.0, 0.0, 3.1, 0.0, 0.0], False),
        ([0.0, np.radians(9.9), 0.0, 0.0, 0.0, 0.0], True),
        ([0.0, np.radians(10.1), 0.0, 0.0, 0.0, 0.0], False),
    ],
)
def test_a_measured_loop_may_be_wrong_by_three_metres_and_ten_degrees(error: list[float], true: bool) -> None:
    truth = circle(50.0, 2, 201)
    T_match_query = se3.inverse(truth[20]) @ truth[121] @ se3.exp(np.array(error))
    assert is_true_loop(truth, 121, 20, T_match_query) is true


def test_a_right_measurement_is_a_true_loop_from_however_far() -> None:
    truth = line(np.array([0.0, 30.0]))
    assert is_true_loop(truth, 1, 0, se3.inverse(truth[0]) @ truth[1])


def test_a_loop_measured_from_the_wrong_side_is_false() -> None:
    truth = line(np.array([0.0, 4.0]))
    assert not is_true_loop(truth, 1, 0, se3.inverse(truth[1]) @ truth[0])


def test_the_second_lap_is_a_revisit_and_the_first_is_not() -> None:
    revisits = find_revisits(circle(50.0, 2, 401))
    assert not revisits[:190].any()
    assert revisits[200:].all()


def test_a_straight_road_has_no_revisits() -> None:
    assert not find_revisits(line(np.arange(0.0, 200.0, 0.3))).any()


def test_standing_still_is_no_revisit() -> None:
    assert not find_revisits(line(np.concatenate([np.arange(50.0), np.full(100, 49.0)]))).any()


def test_coming_back_in_the_opposite_direction_is_no_revisit() -> None:
    out, back = np.arange(0.0, 50.0), np.arange(50.0, 0.0, -1.0)
    z, turned = np.concatenate([out, back]), np.repeat([0.0, np.pi], 50)
    assert not find_revisits(line(z, turned)).any()


def test_backing_over_fifty_metres_is_a_revisit() -> None:
    revisits = find_revisits(line(np.concatenate([np.arange(0.0, 25.0), np.arange(25.0, 0.0, -1.0)])))
    assert 25 < np.flatnonzero(revisits)[0] < 40
    assert revisits[40:].all()


def test_revisits_are_those_of_a_plain_loop() -> None:
    truth = circle(8.0, 2.5, 150)
    path_m = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1))])
    expected = [
        any(
            np.linalg.norm(truth[q, :3, 3] - truth[m, :3, 3]) <= 10.0
            and path_m[q] - path_m[m] >= 20.0
            and truth[q, :3, 2] @ truth[m, :3, 2] >= np.cos(np.radians(45.0))
            for m in range(q)
        )
        for q in range(len(truth))
    ]
    assert find_revisits(truth).tolist() == expected


@pytest.mark.parametrize(("sequence", "has_loops"), [("05", True), ("07", True), ("01", False), ("04", False)])
def test_kitti_has_the_revisits_it_is_known_for(test_data: Path, sequence: str, has_loops: bool) -> None:
    revisits = find_revisits(read_kitti(test_data / "kitti_poses" / f"{sequence}.txt"))
    assert revisits.any() == has_loops


def test_the_reverse_revisits_of_kitti_08_do_not_count(test_data: Path) -> None:
    truth = read_kitti(test_data / "kitti_poses" / "08.txt")
    both_directions = find_revisits(truth, LoopRule(revisit=RevisitRule(max_angle_deg=180.0)))
    assert find_revisits(truth).sum() < 0.1 * both_directions.sum()


def test_counts_of_a_loop_log() -> None:
    truth = circle(50.0, 2, 401)
    rows = [
        row(250, 50),
        row(251, 51),
        row(252, 52, in_graph=False),
        row(253, 100),
        row(150, 3, in_graph=False),
    ]
    counts = count_loops(rows, np.arange(401), truth)
    assert (counts.proposed, counts.verified, counts.kept) == (5, 3, 3)
    assert (counts.true, counts.false) == (2, 1)
    assert counts.precision == pytest.approx(2 / 3)
    assert counts.recall == pytest.approx(2 / find_revisits(truth).sum())


def test_the_truth_of_the_loop_log_is_kept() -> None:
    truth = circle(50.0, 2, 401)
    counts = count_loops([row(250, 50, truth=False), row(251, 51, truth=True)], np.arange(401), truth)
    assert (counts.true, counts.false) == (1, 1)


def test_recall_asks_only_for_what_was_asked() -> None:
    truth = circle(50.0, 2, 401)
    counts = count_loops([row(250, 50)], np.array([10, 250, 300]), truth)
    assert counts.recall == pytest.approx(0.5)


def test_one_revisit_closed_twice_counts_once() -> None:
    truth = circle(50.0, 2, 401)
    assert count_loops([row(250, 50), row(250, 51)], np.array([250, 300]), truth).recall == pytest.approx(0.5)


def test_without_ground_truth_there_are_counts_and_reasons() -> None:
    counts = count_loops([row(250, 50)], np.arange(401), None)
    assert (counts.kept, counts.true, counts.false, counts.precision, counts.recall) == (1, *[None] * 4)
    assert counts.reasons["recall"] == "there is no ground truth"


def test_a_drive_without_loops_says_why_there_is_no_figure() -> None:
    counts = count_loops([], np.arange(50), line(np.arange(50.0)))
    assert (counts.kept, counts.true, counts.precision, counts.recall) == (0, 0, None, None)
    assert counts.reasons == {
        "precision": "no loop was kept",
        "recall": "no query is a revisit by ground truth",
    }


def test_metrics_have_the_documented_names() -> None:
    names = ["proposed", "verified", "kept", "true", "false", "precision", "recall"]
    assert list(count_loops([], np.arange(2), None).as_metrics()) == names


def test_the_error_of_a_loop_does_not_depend_on_where_and_how_its_cameras_stood() -> None:
    truth = circle(50.0, 2, 201)
    for query, match in ((121, 20), (180, 81)):
        left_over = se3.exp(np.array([0.0, np.radians(2.0), 0.0, 0.3, 0.0, -0.4]))
        error = loop_error(truth, query, match, se3.inverse(truth[match]) @ truth[query] @ left_over)
        assert error.translation_m == pytest.approx(0.5, rel=1e-3)
        assert error.rotation_deg == pytest.approx(2.0)


def test_only_kept_loops_are_summarized_by_median_95th_percentile_and_maximum() -> None:
    loops = [row(100 + k, k) for k in range(21)] + [row(150, 3, in_graph=False), row(151, 4)]
    stages = [StageRow(100 + k, k, translation_error_m=0.1 * k, rotation_error_deg=float(k)) for k in range(21)]
    stages += [StageRow(150, 3, translation_error_m=99.0, rotation_error_deg=99.0), StageRow(151, 4)]
    summary = summarize_loop_errors(kept_loop_errors(loops, stages))
    assert summary["translation_error_m"] == pytest.approx({"median": 1.0, "p95": 1.9, "max": 2.0})
    assert summary["rotation_error_deg"] == pytest.approx({"median": 10.0, "p95": 19.0, "max": 20.0})


def test_without_kept_loops_there_is_no_summary() -> None:
    assert summarize_loop_errors([]) == {"translation_error_m": None, "rotation_error_deg": None}
    assert np.isnan(LoopError().translation_m)


@pytest.mark.parametrize("max_distance_m", [3.0, 10.0, 40.0])
def test_revisits_that_are_computed_cell_by_cell_are_those_of_the_matrix(max_distance_m: float) -> None:
    rng = np.random.default_rng(3)
    poses = np.concatenate([circle(50.0, 2.3, 700), circle(50.0, 0.4, 130, clockwise=False)])
    poses[:, :3, 3] += rng.normal(0.0, 0.5, (len(poses), 3))
    rule = LoopRule(revisit=RevisitRule(max_distance_m=max_distance_m))
    matrix, computed = revisit_matrix(poses, rule), revisit_truth(poses, rule)
    assert matrix.any()
    np.testing.assert_array_equal(computed.any(axis=1), matrix.any(axis=1))
    assert computed.any() == matrix.any()
    queries, columns = np.indices(matrix.shape).reshape(2, -1)
    np.testing.assert_array_equal(computed[queries, columns], matrix[queries, columns])
    assert computed.shape == matrix.shape
    assert len(computed) == len(matrix)


def test_a_drive_without_revisits_has_none_cell_by_cell() -> None:
    assert not revisit_truth(line(np.arange(0.0, 900.0, 0.3))).any()
    assert not PoseTruth(np.empty((0, 4, 4))).any()


def test_a_rule_that_needs_whole_rows_is_refused_cell_by_cell() -> None:
    with pytest.raises(ValueError, match="one to one"):
        PoseTruth(line(np.arange(9.0)), rule=RevisitRule(is_one_to_one=True))
