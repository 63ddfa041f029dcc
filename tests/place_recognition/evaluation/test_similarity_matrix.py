"""Rows become a matrix, however long the drive."""

import numpy as np
import pytest

from place_recognition.evaluation.similarity_matrix import MatrixRecorder


def test_rows_stand_where_they_belong_and_the_rest_is_unknown():
    rows = MatrixRecorder()
    rows.add(3, np.array([0, 2]), np.array([5.0, 7.0]))
    values = rows.matrix(4).values
    assert values.shape == (4, 4)
    assert (values[3, 0], values[3, 2]) == (5, 7)
    assert np.isfinite(values).sum() == 2


def test_stages_are_kept_apart():
    rows = MatrixRecorder()
    rows.add(1, np.array([0]), np.array([1.0]))
    rows.add(1, np.array([0]), np.array([-2.0]), "filtered")
    assert rows.stages == ("similarity", "filtered")
    assert (rows.matrix(2).values[1, 0], rows.matrix(2, "filtered").values[1, 0]) == (1, -2)


def test_a_stage_without_rows_is_unknown_throughout():
    assert np.isnan(MatrixRecorder().matrix(3).values).all()


@pytest.mark.parametrize("limit", [1, 3, 8, 100])
def test_a_long_drive_keeps_the_largest_value_of_the_images_that_share_a_cell(limit):
    rng = np.random.default_rng(0)
    full = np.where(rng.random((37, 37)) > 0.3, rng.normal(size=(37, 37)), np.nan).astype(np.float32)
    full[np.triu_indices(37)] = np.nan
    rows = MatrixRecorder(limit)
    for query in range(37):
        matches = np.flatnonzero(np.isfinite(full[query]))
        rows.add(query, matches, full[query, matches].astype(np.float64))
    matrix = rows.matrix(37)
    assert len(matrix.values) <= limit
    for i, j in np.ndindex(matrix.values.shape):
        block = full[i * matrix.step : (i + 1) * matrix.step, j * matrix.step : (j + 1) * matrix.step]
        known = block[np.isfinite(block)]
        assert np.array_equal(matrix.values[i, j], known.max() if len(known) else np.nan, equal_nan=True)


def test_rows_may_come_late_and_in_any_order():
    rows = MatrixRecorder()
    rows.add(9, np.array([1]), np.array([1.0]))
    rows.add(4, np.array([2]), np.array([3.0]))
    rows.add(9, np.array([1]), np.array([0.5]))
    values = rows.matrix(10).values
    assert (values[9, 1], values[4, 2]) == (1, 3)
