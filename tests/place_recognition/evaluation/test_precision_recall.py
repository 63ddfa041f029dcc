"""Truth and its measures."""

import contextlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from place_recognition.evaluation.precision_recall import accepted_counts, is_correct, precision_recall
from place_recognition.evaluation.revisit_ground_truth import RevisitRule, load_truth, truth_from_poses
from place_recognition.recognizer import Belief


def belief(query, match, score, verified=True):
    return Belief(query, match, score, accepted=verified and score > 5, verified=verified)


def circle(laps, images, radius):
    """Poses (N, 4, 4) of a camera that looks where it goes, round a circle in the x-z plane."""
    angles = np.linspace(0, 2 * np.pi * laps, images)
    poses = np.tile(np.eye(4), (images, 1, 1))
    poses[:, 0, 3], poses[:, 2, 3] = radius * np.cos(angles), radius * np.sin(angles)
    poses[:, 0, 2], poses[:, 2, 2] = -np.sin(angles), np.cos(angles)
    return poses


def test_a_second_lap_sees_the_places_of_the_first():
    truth = truth_from_poses(
        circle(2, 201, 50)[:-1], np.arange(200.0), RevisitRule(max_distance_m=1, min_time_gap_s=40)
    )
    np.testing.assert_array_equal(np.argwhere(truth), [[i, i - 100] for i in range(100, 200)])


def test_the_return_path_is_the_same_place_only_if_headings_do_not_matter():
    poses = circle(0.25, 30, 50)
    back = poses[::-1].copy()
    back[:, :3, 2] *= -1
    both, times = np.concatenate([poses, back]), np.arange(60.0)
    assert not truth_from_poses(both, times, RevisitRule(1, 90 - 1e-6, 5)).any()
    assert truth_from_poses(both, times, RevisitRule(1, 180, 5)).any()


def test_the_time_between_is_kept():
    truth = truth_from_poses(
        np.tile(np.eye(4), (10, 1, 1)), 10.0 * np.arange(10), RevisitRule(1, 45, 40, min_path_length_m=0)
    )
    query, match = np.nonzero(truth)
    assert (query - match).min() == 4


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_truth_agrees_with_a_plain_loop_over_all_pairs(seed):
    rng = np.random.default_rng(seed)
    poses = np.tile(np.eye(4), (int(rng.integers(1, 600, endpoint=True)) // 15 + 1, 1, 1))
    angles, times = rng.uniform(0, 6, len(poses)), np.sort(rng.uniform(0, 60, len(poses)))
    poses[:, 0, 3], poses[:, 2, 3] = rng.uniform(0, 9, (2, len(poses)))
    poses[:, 0, 2], poses[:, 2, 2] = np.sin(angles), np.cos(angles)
    rule = RevisitRule(max_distance_m=4, max_angle_deg=50, min_time_gap_s=3, min_path_length_m=15)
    path = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1))])
    truth = truth_from_poses(poses, times, rule)
    for q, m in np.ndindex(truth.shape):
        near = np.linalg.norm(poses[q, :3, 3] - poses[m, :3, 3]) <= 4
        aligned = np.cos(angles[q] - angles[m]) >= np.cos(np.radians(50))
        assert truth[q, m] == (m < q and near and aligned and path[q] - path[m] >= 15 and times[q] - times[m] >= 3)


def test_blocks_of_rows_join_without_a_seam():
    truth = truth_from_poses(circle(3, 901, 60)[:-1], rule=RevisitRule(max_distance_m=0.5))
    np.testing.assert_array_equal(
        np.argwhere(truth), [[i, j] for i in range(900) for j in range(i % 300, i, 300) if i - j >= 300]
    )


def test_one_to_one_keeps_the_nearest_image_of_each_band():
    poses = circle(2, 201, 50)[:-1]
    band = truth_from_poses(poses, rule=RevisitRule(max_distance_m=7))
    nearest = truth_from_poses(poses, rule=RevisitRule(max_distance_m=7, is_one_to_one=True))
    assert (band[150:].sum(axis=1) > 1).all()
    np.testing.assert_array_equal(nearest.any(axis=1), band.any(axis=1))
    np.testing.assert_array_equal(np.argwhere(nearest[120:]), [[i, i + 20] for i in range(80)])


def test_standing_still_is_no_revisit():
    assert not truth_from_poses(np.tile(np.eye(4), (50, 1, 1))).any()


def test_poses_without_as_many_times_are_refused():
    poses = np.tile(np.eye(4), (2, 1, 1))
    with pytest.raises(ValueError, match="expected as many times as there are poses, 2, got"):
        truth_from_poses(poses, np.arange(3.0))
    with pytest.raises(ValueError, match="expected the times of the 2 poses for a gap of 40 s"):
        truth_from_poses(poses, None, RevisitRule(min_time_gap_s=40))
    with pytest.raises(ValueError, match="expected finite poses"):
        truth_from_poses(np.full((2, 4, 4), np.nan))


@pytest.mark.parametrize("turned", [False, True])
def test_truth_survives_both_kinds_of_file_in_both_triangles(tmp_path, turned):
    truth = np.tril(np.random.default_rng(0).random((9, 9)) > 0.7, -1)
    stored = truth.T if turned else truth
    savemat(tmp_path / "a.mat", {"truth": stored.astype(np.uint8)})
    np.savez(tmp_path / "a.npz", truth=stored)
    for name in ("a.mat", "a.npz"):
        np.testing.assert_array_equal(load_truth(tmp_path / name), truth)


def test_a_file_without_a_truth_matrix_is_named(tmp_path):
    np.savez(tmp_path / "b.npz", loops=np.eye(3))
    (tmp_path / "c.mat").write_text("no matrix")
    with pytest.raises(ValueError, match=r"b\.npz: expected an array named truth, found loops"):
        load_truth(tmp_path / "b.npz")
    with pytest.raises(ValueError, match=r"c\.mat: expected an intact MATLAB file"):
        load_truth(tmp_path / "c.mat")
    (tmp_path / "d.txt").touch()
    with pytest.raises(ValueError, match=r"expected a truth file \.npz or \.mat"):
        load_truth(tmp_path / "d.txt")


@pytest.mark.parametrize("kept", [0, 10, 60, 200])
@pytest.mark.parametrize("suffix", [".npz", ".mat"])
def test_a_file_cut_short_is_named(tmp_path, suffix, kept):
    path, truth = tmp_path / f"cut{suffix}", np.eye(40, k=-3)
    savemat(path, {"truth": truth}, do_compression=True) if suffix == ".mat" else np.savez_compressed(path, truth=truth)
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(ValueError, match=rf"cut\{suffix}: expected"):
        load_truth(path)


@settings(max_examples=40, deadline=None)
@given(position=st.integers(0, 2000), byte=st.integers(0, 255), suffix=st.sampled_from([".npz", ".mat"]))
def test_a_damaged_byte_gives_a_matrix_or_a_clear_error(tmp_path_factory, position, byte, suffix):
    path, truth = tmp_path_factory.mktemp("damaged") / f"d{suffix}", np.random.default_rng(0).random((30, 30)) > 0.5
    savemat(path, {"truth": truth}, do_compression=True) if suffix == ".mat" else np.savez_compressed(path, truth=truth)
    content = bytearray(path.read_bytes())
    content[position % len(content)] ^= byte
    path.write_bytes(bytes(content))
    with contextlib.suppress(ValueError):  # the only kind of error that may come
        assert load_truth(path).dtype == bool


def test_a_matrix_of_words_and_a_missing_file_are_refused(tmp_path):
    np.savez(tmp_path / "w.npz", truth=np.array([["a", "b"], ["c", "d"]]))
    with pytest.raises(ValueError, match=r"w\.npz: expected a truth matrix of numbers"):
        load_truth(tmp_path / "w.npz")
    with pytest.raises(ValueError, match=r"none\.npz: expected a truth file, found none"):
        load_truth(tmp_path / "none.npz")


@pytest.mark.parametrize(("name", "images", "rows"), [("KITTI00", 4541, 851), ("KITTI06", 1101, 272)])
def test_the_authors_matrices_have_the_rows_they_are_known_for(test_data, name, images, rows):
    truth = load_truth(test_data / "loop_ground_truth" / f"groundTruth{name}.mat")
    assert truth.shape == (images, images)
    assert truth.any(axis=1).sum() == rows


def test_precision_and_recall_by_hand():
    truth = np.zeros((6, 6), bool)
    truth[3, 0] = truth[4, 1] = truth[5, 2] = True
    beliefs = [belief(3, 0, 9), belief(4, 2, 7), belief(5, 2, 7), belief(2, 0, 1), belief(1, None, 0)]
    curve = precision_recall(beliefs, truth)
    np.testing.assert_array_equal(curve.thresholds, [9, 7, 1])
    np.testing.assert_allclose(curve.precision, [1, 2 / 3, 2 / 4])
    np.testing.assert_allclose(curve.recall, [1 / 3, 2 / 3, 2 / 3])
    assert (curve.recall_at_full_precision, curve.threshold_at_full_precision) == (pytest.approx(1 / 3), 9)
    assert curve.average_precision == pytest.approx(1 / 3 + 1 / 3 * 2 / 3)
    assert accepted_counts(beliefs, truth) == (2, 1)


def test_a_tie_of_a_right_and_a_wrong_detection_gives_no_full_precision():
    truth = np.eye(4, k=-2) > 0
    curve = precision_recall([belief(2, 0, 5), belief(3, 0, 5)], truth)
    assert curve.recall_at_full_precision == 0
    assert curve.threshold_at_full_precision is None


def test_a_match_that_failed_its_verification_is_no_detection():
    truth = np.eye(4, k=-2) > 0
    curve = precision_recall([belief(2, 0, 5), belief(3, 0, 9, verified=False)], truth)
    assert curve.recall_at_full_precision == 0.5


def test_tolerance_forgives_so_many_columns():
    truth = np.zeros((9, 9), bool)
    truth[8, 3] = True
    near = [belief(8, match, 5) for match in range(8)]
    np.testing.assert_array_equal(
        is_correct(near, truth, tolerance=2), [False, True, True, True, True, True, False, False]
    )


def test_nothing_detected_is_no_error():
    curve = precision_recall([], np.zeros((3, 3), bool))
    assert (curve.average_precision, curve.recall_at_full_precision) == (0, 0)


def test_a_query_that_the_truth_does_not_know_is_refused():
    with pytest.raises(ValueError, match="expected query and earlier match below 3, got 5 and 1"):
        is_correct([belief(5, 1, 2)], np.zeros((3, 3), bool))


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_curve_agrees_with_a_plain_count_at_each_threshold(seed):
    rng = np.random.default_rng(seed)
    truth = np.tril(rng.random((20, 20)) > 0.6, -1)
    queries = np.arange(1, 20)
    beliefs = [belief(int(q), int(rng.integers(q)), float(rng.integers(6)), bool(rng.random() > 0.2)) for q in queries]
    average, recall, best = 0.0, 0.0, 0.0
    rows = max(int(truth.any(axis=1).sum()), 1)
    for threshold in sorted({b.score for b in beliefs if b.verified}, reverse=True):
        taken = [b for b in beliefs if b.verified and b.score >= threshold]
        hits = sum(bool(truth[b.query, b.match]) for b in taken)
        average += hits / len(taken) * (hits / rows - recall)
        recall = hits / rows
        best = max(best, recall) if hits == len(taken) else best
    curve = precision_recall(beliefs, truth)
    assert curve.average_precision == pytest.approx(average)
    assert curve.recall_at_full_precision == pytest.approx(best)


def test_a_match_with_a_probability_counts_without_geometry_of_its_own():
    truth = np.eye(4, k=-2) > 0
    failed = Belief(2, 0, 5.0, accepted=False, verified=False, probability=0.9)
    assert precision_recall([failed], truth).recall_at_full_precision == 0.5
