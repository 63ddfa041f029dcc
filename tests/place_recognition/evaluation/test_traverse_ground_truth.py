"""Ground truth of two recordings: the rules, the files, and what is tolerated."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.io import savemat

from odometry import se3
from place_recognition.evaluation.precision_recall import leave_out_tolerated, precision_recall
from place_recognition.evaluation.stages import measure_stages
from place_recognition.evaluation.traverse_ground_truth import (
    read_traverse_truth,
    truth_of_equal_numbers,
    truth_of_poses,
    truth_of_positions,
)
from place_recognition.recognizer import Belief, StageScores


def test_equal_numbers_count_and_those_beside_them_are_tolerated():
    truth = truth_of_equal_numbers(6, 1, 3)
    assert truth.hard[2].tolist() == [False, True, True, True, False, False]
    assert truth.tolerated[2].tolist() == [True, False, False, False, True, True]
    assert truth_of_equal_numbers(6, 0).tolerated is None


def test_positions_count_by_their_distance_on_both_sides_of_a_block():
    queries, references = np.array([[0.0, 0.0], [100.0, 0.0]]), np.array([[0.0, 24.9], [0.0, 25.1], [100.0, 60.0]])
    truth = truth_of_positions(np.repeat(queries, 200, axis=0), references, 25.0, 50.0)
    assert truth.hard[[0, 199, 200, 399]].tolist() == 2 * [[True, False, False]] + 2 * [[False] * 3]
    assert truth.tolerated[0].tolist() == [False, True, False]


@given(st.integers(0, 2**32 - 1))
def test_the_frame_of_the_poses_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    poses = np.array([se3.exp(rng.normal(0, [2, 2, 2, 20, 20, 20])) for _ in range(9)])
    T_other_world = se3.exp(rng.normal(0, [1, 1, 1, 50, 50, 50]))
    here = truth_of_poses(poses[:4], poses[4:], 20.0, 60.0, 40.0)
    there = truth_of_poses(T_other_world @ poses[:4], T_other_world @ poses[4:], 20.0, 60.0, 40.0)
    np.testing.assert_array_equal(here.hard, there.hard)
    np.testing.assert_array_equal(here.tolerated, there.tolerated)


def test_a_camera_that_looks_back_is_at_another_place():
    back = np.diag([-1.0, 1.0, -1.0, 1.0])
    assert truth_of_poses(np.eye(4)[None], np.stack([np.eye(4), back]), 10.0, 45.0).hard.tolist() == [[True, False]]


HARD = np.array([[1, 0, 0], [0, 1, 0]])
SOFT = np.array([[1, 1, 0], [0, 1, 1]])


def test_a_matrix_is_read_with_a_row_for_each_query_however_it_lies(tmp_path):
    np.savez(tmp_path / "ours.npz", truth=HARD, soft=SOFT)
    np.savez(tmp_path / "turned.npz", truth=HARD.T)
    np.savez(tmp_path / "tutorial.npz", GThard=HARD.T, GTsoft=SOFT.T)
    savemat(tmp_path / "m.mat", {"GT": HARD, "names": np.arange(4.0)[None]})
    for name in ("ours.npz", "turned.npz", "tutorial.npz", "m.mat"):
        truth = read_traverse_truth(tmp_path / name, (2, 3))
        assert truth.hard.tolist() == HARD.astype(bool).tolist()
        assert bool(truth.remarks) == (name in ("turned.npz", "tutorial.npz"))
        if name in ("ours.npz", "tutorial.npz"):
            assert truth.tolerated.tolist() == ((SOFT > 0) & (HARD == 0)).tolist()


def test_a_square_matrix_of_the_tutorial_is_turned_and_ours_is_not(tmp_path):
    square = np.zeros((4, 4))
    square[0, 3] = 1
    np.savez(tmp_path / "tutorial.npz", GThard=square)
    np.savez(tmp_path / "ours.npz", truth=square)
    assert read_traverse_truth(tmp_path / "tutorial.npz", (4, 4)).hard[3, 0]
    assert read_traverse_truth(tmp_path / "ours.npz", (4, 4)).hard[0, 3]


BAD = {
    "none.npz": (None, "expected a truth file, found none"),
    "names.npz": ({"loops": HARD}, "expected an array named truth, found loops; name it truth"),
    "shape.npz": ({"truth": np.eye(4)}, r"expected truth with 2 queries and 3 reference images, found \(4, 4\)"),
    "scores.npz": ({"truth": np.arange(6.0).reshape(2, 3)}, "compare them with a threshold first"),
    "words.npz": ({"truth": np.array([["a", "b", "c"]] * 2)}, "save 0 and 1"),
    "soft.npz": ({"truth": HARD, "soft": np.eye(2)}, "expected soft with 2 queries and 3 reference images"),
    "two.mat": ({"a": HARD, "b": HARD}, "expected one matrix of 2 queries and 3 reference images, found a .* b"),
    "other.mat": ({"a": np.eye(5)}, r"found a \(5, 5\)"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_file_is_refused_in_one_line_that_names_it(tmp_path, name):
    content, message = BAD[name]
    if content is not None:
        write = savemat if name.endswith("mat") else lambda path, arrays: np.savez(path, **arrays)
        write(tmp_path / name, content)
    with pytest.raises(ValueError, match=message) as error:
        read_traverse_truth(tmp_path / name, (2, 3))
    assert str(error.value).startswith(str(tmp_path / name))
    assert "\n" not in str(error.value)


def test_0_for_the_same_place_is_noticed(tmp_path):
    np.savez(tmp_path / "inverse.npz", truth=1 - np.eye(12, 10))
    with pytest.raises(ValueError, match="exchange 0 and 1"):
        read_traverse_truth(tmp_path / "inverse.npz", (12, 10))


def test_a_damaged_file_is_refused(tmp_path):
    for name in ("x.npz", "x.mat"):
        (tmp_path / name).write_bytes(b"PK\x03\x04 no archive")
        with pytest.raises(ValueError, match="expected an intact"):
            read_traverse_truth(tmp_path / name, (2, 3))


def answers(similarity, order):
    """Beliefs and candidates, best first, of a similarity matrix (N, M)."""
    return [
        Belief(q, int(row[0]), float(similarity[q, row[0]]), False, stages=StageScores(tuple(row[:10].tolist()), 1.0))
        for q, row in enumerate(order)
    ]


@given(st.integers(0, 2**32 - 1))
def test_recall_at_k_is_that_of_the_tutorial(seed):
    """Its rule: pairs that are soft alone get the smallest similarity; queries without a hard pair are left out."""
    rng = np.random.default_rng(seed)
    similarity = rng.random((12, 10))
    hard = rng.random((12, 10)) < 0.15
    hard[0, 0] = True
    soft = hard | (rng.random((12, 10)) < 0.15)
    order = np.argsort(-similarity, axis=1)
    measured = measure_stages(leave_out_tolerated(answers(similarity, order), soft & ~hard), hard).candidate_recall
    lowered = np.where(soft & ~hard, -1.0, similarity)
    best = np.argsort(-lowered, axis=1)
    for count in (1, 5):
        found = np.take_along_axis(hard & (lowered >= 0), best[:, :count], axis=1).any(axis=1)
        assert measured[count] == pytest.approx(found[hard.any(axis=1)].mean())


def test_a_tolerated_match_counts_neither_as_true_nor_as_false():
    hard, tolerated = np.array([[True, False, False]]), np.array([[False, True, False]])
    curves = [
        precision_recall(leave_out_tolerated([Belief(0, match, 1.0, True)], tolerated), hard) for match in range(3)
    ]
    assert [curve.true_positives.tolist() for curve in curves] == [[1], [], [0]]
    assert [curve.false_positives.tolist() for curve in curves] == [[0], [], [1]]
    assert {curve.truth_rows for curve in curves} == {1}


def test_a_match_may_have_a_larger_number_than_its_query():
    assert precision_recall([Belief(0, 2, 1.0, True)], np.array([[False, False, True]])).recall.tolist() == [1.0]
    with pytest.raises(ValueError, match="below 1 and 3"):
        precision_recall([Belief(0, 3, 1.0, True)], np.array([[False, False, True]]))
