"""What SciPy writes for MATLAB comes back, and damage is an error and never the end of the process."""

import random
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat
from scipy.sparse import csc_matrix

from place_recognition.evaluation import ground_truth_files
from place_recognition.evaluation.ground_truth_files import read_matrices
from place_recognition.evaluation.matlab_process import MAX_VALUES, count_values
from place_recognition.evaluation.revisit_ground_truth import load_truth, read_truth_matrix

KINDS = ["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "?"]
KILLERS = Path(__file__).parents[2] / "fuzzing" / "corpus" / "truth-MATLAB"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "a.mat"


def matrices(seed: int) -> dict[str, np.ndarray]:
    """Matrices of every kind and of several shapes, by name."""
    rng, made = np.random.default_rng(seed), {}
    for kind in KINDS:
        for rows, columns in ((1, 2), (5, 1), (3, 3), (4, 5), (9, 8)):
            low = -1 if kind[0] in "fi" else 0
            made[f"of_{kind.replace('?', 'bool')}_{rows}_{columns}"] = rng.integers(low, 3, (rows, columns)).astype(
                kind
            )
    return made


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("sparse", [False, True])
def test_matrices_come_back_from_a_file_that_scipy_wrote(file: Path, packed: bool, sparse: bool) -> None:
    whole = matrices(seed=2 * packed + sparse)
    written = {name: csc_matrix(value.astype(float)) for name, value in whole.items()} if sparse else whole
    savemat(file, written, do_compression=packed)
    read = read_matrices(file)
    assert set(read) == set(whole)
    for name, value in whole.items():
        assert read[name].positive.dtype == np.bool_
        np.testing.assert_array_equal(read[name].positive, value > 0)
        assert read[name].num_values == len(np.unique(value))


def test_what_is_no_matrix_of_real_numbers_is_left_out(file: Path) -> None:
    cells = np.array([1, "x"], object)
    savemat(
        file, {"a": np.eye(2), "one": 3.0, "text": "words", "cells": cells, "table": {"x": 1.0}, "z": np.eye(2) * 1j}
    )
    assert set(read_matrices(file)) == {"a"}
    savemat(file, {"text": "words", "one": 3.0})
    assert read_matrices(file) == {}
    with pytest.raises(ValueError, match="expected one matrix of numbers, found none"):
        load_truth(file)
    savemat(file, {"first": np.eye(2), "second": np.eye(2)})
    with pytest.raises(ValueError, match="expected one matrix of numbers, found first, second"):
        load_truth(file)


def test_the_other_order_of_bytes_is_read_too(file: Path) -> None:
    header = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x01\x00MI"
    numbers = [(6, np.array([6, 0], ">u4")), (5, np.array([1, 2], ">i4")), (9, np.array([0.0, 2.0], ">f8"))]
    parts = [(kind, array.tobytes()) for kind, array in numbers]
    parts.insert(2, (1, b"truthfull"))
    body = b"".join(
        kind.to_bytes(4, "big") + len(data).to_bytes(4, "big") + data + bytes(-len(data) % 8) for kind, data in parts
    )
    file.write_bytes(header + (14).to_bytes(4, "big") + len(body).to_bytes(4, "big") + body)
    np.testing.assert_array_equal(read_matrices(file)["truthfull"].positive, [[False, True]])


@pytest.mark.parametrize("killer", sorted(KILLERS.iterdir()), ids=lambda path: path.name)
def test_a_file_that_crashes_scipy_is_one_error(file: Path, killer: Path) -> None:
    file.write_bytes(killer.read_bytes())
    with pytest.raises(ValueError, match="expected an intact MATLAB file of version") as error:
        load_truth(file)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("packed", [False, True])
def test_a_damaged_byte_is_an_error_or_changes_nothing_but_numbers(file: Path, packed: bool) -> None:
    savemat(file, {"truth": csc_matrix(np.eye(4)), "full": np.eye(3, dtype=np.uint8)}, do_compression=packed)
    whole, rng, refused = file.read_bytes(), random.Random(0), 0
    for at in rng.sample(range(124, len(whole)), 20):  # each costs the start of a process
        damaged = bytearray(whole)
        damaged[at] ^= 1 << rng.randrange(8)
        file.write_bytes(damaged if rng.random() < 0.8 else whole[:at])
        try:
            found = [matrix.positive for matrix in read_matrices(file).values()]
            assert all(matrix.ndim == 2 and matrix.dtype == np.bool_ for matrix in found)
        except ValueError as error:
            assert str(error).isprintable()  # noqa: PT017 - both outcomes are right
            refused += 1
    assert refused > 3


@pytest.mark.parametrize(
    ("program", "reason"),
    [
        ("import os; os.abort()", "crashes SciPy .SIGABRT"),
        ("import time; time.sleep(60)", "takes more than 1 s"),
        ("raise SystemExit('bad\\x07 news\\nsecond\\tline')", "second line"),
        ("raise SystemExit('x' * 5000)", "x{200}$"),
        ("raise SystemExit(3)", "ends the reader without a reason"),
    ],
)
def test_whatever_becomes_of_the_reader_is_one_line(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: str, reason: str
) -> None:
    reader = tmp_path / "reader.py"
    reader.write_text(program)
    monkeypatch.setattr(ground_truth_files, "READER", reader)
    monkeypatch.setattr(ground_truth_files, "TIMEOUT_S", 1.0)
    with pytest.raises(ValueError, match=reason) as error:
        read_matrices(file)
    assert str(error.value).isprintable()


def test_a_sparse_matrix_of_any_stated_size_is_refused_before_memory_is_taken(file: Path) -> None:
    savemat(file, {"truth": csc_matrix((100000, 100000))})
    with pytest.raises(ValueError, match="of more than 134217728 numbers"):
        read_matrices(file)


def test_a_file_that_needs_too_much_memory_is_refused(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    savemat(file, {"truth": np.zeros((20000, 2000))}, do_compression=True)  # 320 MB in 0.3 MB
    monkeypatch.setattr(ground_truth_files, "MAX_MEMORY_BYTES", 700 << 20)
    with pytest.raises(ValueError, match="too much memory"):
        read_matrices(file)


@pytest.mark.parametrize("version", ["4", "5"])
def test_both_versions_that_scipy_writes_are_read(file: Path, version: str) -> None:
    truth = np.eye(12, k=-4)
    savemat(file, {"truth": truth}, format=version)
    np.testing.assert_array_equal(load_truth(file), truth > 0)


def test_a_matrix_in_a_structure_is_found(file: Path) -> None:
    truth = np.eye(12, k=-4)
    savemat(file, {"gt": {"drive": {"loops": truth, "name": "05"}, "count": 12.0}})
    assert set(read_matrices(file)) == {"gt.drive.loops"}
    np.testing.assert_array_equal(load_truth(file), truth > 0)


def test_version_7_3_is_named_with_what_to_do(file: Path) -> None:
    header = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512) + b"\x89HDF\r\n\x1a\n"
    for data in (header + bytes(99), b"\x89HDF\r\n\x1a\n" + bytes(99), header.replace(b"MATLAB", b"Octave") + bytes(9)):
        file.write_bytes(data)
        with pytest.raises(ValueError, match=r"a\.mat: expected .* 4 to 7\.2, found version 7\.3 .* save it with -v7$"):
            load_truth(file)


def test_the_text_format_of_octave_is_named(file: Path) -> None:
    file.write_text("# Created by Octave 8.4.0\n# name: truth\n# type: matrix\n")
    with pytest.raises(ValueError, match="found Octave's text format; save it with -v7"):
        load_truth(file)


def test_the_one_square_matrix_is_the_truth_and_the_others_are_named(file: Path) -> None:
    truth = np.eye(12, k=-4)
    savemat(file, {"gps": np.ones((12, 2)), "truth": truth})
    found = read_truth_matrix(file)
    np.testing.assert_array_equal(found.matrix, truth > 0)
    assert found.remarks == (f"{file}: the truth is truth, the one square matrix; passed over gps",)


def save(folder: Path, suffix: str, matrix: np.ndarray) -> Path:
    path = folder / f"truth{suffix}"
    savemat(path, {"truth": matrix}) if suffix != ".npz" else np.savez(path, truth=matrix)
    return path


SUFFIXES = pytest.mark.parametrize("suffix", [".mat", ".npz", ".MAT"])


@SUFFIXES
def test_scores_and_distances_are_refused(tmp_path: Path, suffix: str) -> None:
    positions = np.random.default_rng(0).random((12, 2))
    distances = np.linalg.norm(positions[:, None] - positions, axis=2)
    for matrix in (distances, np.exp(-distances), np.round(5 * distances)):
        with pytest.raises(ValueError, match=r"expected 0 and 1 .* different values, such as scores or distances"):
            load_truth(save(tmp_path, suffix, matrix))


@SUFFIXES
def test_zero_for_the_same_place_is_refused(tmp_path: Path, suffix: str) -> None:
    with pytest.raises(ValueError, match="most pairs of images are the same place; exchange 0 and 1"):
        load_truth(save(tmp_path, suffix, 1 - np.eye(12, k=-4)))


@SUFFIXES
@pytest.mark.parametrize("number", [1, 255, 0.5])
def test_any_number_stands_for_the_same_place(tmp_path: Path, suffix: str, number: float) -> None:
    found = read_truth_matrix(save(tmp_path, suffix, number * np.eye(12, k=-4)))
    np.testing.assert_array_equal(found.matrix, np.eye(12, k=-4) > 0)
    assert found.remarks == ()


@SUFFIXES
@pytest.mark.parametrize("turned", [False, True])
def test_a_stray_entry_does_not_change_the_triangle(tmp_path: Path, suffix: str, turned: bool) -> None:
    stored = np.eye(12, k=-4)
    stored[1, 7] = 1
    path = save(tmp_path, suffix, stored.T if turned else stored)
    found = read_truth_matrix(path)
    np.testing.assert_array_equal(found.matrix, np.eye(12, k=-4) > 0)
    used, side, at = ("upper", "below", "row 7, column 1") if turned else ("lower", "above", "row 1, column 7")
    assert found.remarks == (
        f"{path}: the {used} triangle is used with 8 entries; passed over 1 entry {side} the diagonal without a mirror"
        f" image (first in {at}, from 0)",
    )


@SUFFIXES
def test_a_symmetric_matrix_is_its_lower_triangle(tmp_path: Path, suffix: str) -> None:
    found = read_truth_matrix(save(tmp_path, suffix, np.eye(12, k=-4) + np.eye(12, k=4) + np.eye(12)))
    np.testing.assert_array_equal(found.matrix, np.eye(12, k=-4) > 0)
    assert found.remarks == ()


def test_a_band_of_neighbours_is_said(tmp_path: Path) -> None:
    found = read_truth_matrix(save(tmp_path, ".npz", np.eye(30, k=-1) + np.eye(30, k=-14)))
    assert "29 images are the same place as the image before them" in found.remarks[0]


def test_values_are_counted_up_to_a_bound_and_nan_once() -> None:
    assert count_values(np.array([[np.nan, 1.0], [0.0, np.nan], [1.0, np.nan]])) == 3
    assert count_values(np.arange(200).reshape(20, 10)) == MAX_VALUES
    assert count_values(np.array([[True, False]])) == 2


@pytest.mark.parametrize(("num_nans", "words"), [(1, "1 cell is NaN"), (3, "3 cells are NaN")])
def test_cells_that_are_not_numbers_are_counted(file: Path, num_nans: int, words: str) -> None:
    truth = np.eye(12, k=-4)
    truth[9, :num_nans] = np.nan
    savemat(file, {"truth": truth})
    np.savez(file.with_suffix(".npz"), truth=truth)
    for path in (file, file.with_suffix(".npz")):
        found = read_truth_matrix(path)
        np.testing.assert_array_equal(found.matrix, truth > 0)
        assert found.remarks == (f"{path}: {words} and count as another place; write 0 or 1",)
    savemat(file, {"truth": np.eye(12, k=-4)})
    assert read_truth_matrix(file).remarks == ()
