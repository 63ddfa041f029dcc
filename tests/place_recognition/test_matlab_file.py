"""What SciPy writes for MATLAB comes back, and damage is an error and never the end of the process."""

import random
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import savemat
from scipy.sparse import csc_matrix

from place_recognition.evaluation.matlab_file import read_variables

KINDS = ["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "?"]


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("matlab") / "a.mat"


@settings(max_examples=60, deadline=None)
@given(
    kind=st.sampled_from(KINDS), rows=st.integers(0, 5), columns=st.integers(1, 5), seed=st.integers(0, 100),
    packed=st.booleans(), sparse=st.booleans(), name=st.text("abcXYZ_09", min_size=1, max_size=12).map("a".__add__),
)  # fmt: skip
def test_a_matrix_comes_back_from_a_file_that_scipy_wrote(
    file: Path, kind: str, rows: int, columns: int, seed: int, packed: bool, sparse: bool, name: str
) -> None:
    whole = np.random.default_rng(seed).integers(-1 if kind[0] in "fi" else 0, 3, (rows, columns)).astype(kind)
    value = csc_matrix(whole.astype(float)) if sparse else whole
    savemat(file, {name: value}, do_compression=packed)
    (variable,) = read_variables(file)
    assert (variable.name, variable.shape) == (name, (rows, columns))
    np.testing.assert_array_equal(variable.positive(), whole > 0)


def test_every_variable_is_told_and_those_without_numbers_are_refused(file: Path) -> None:
    savemat(file, {"a": np.eye(2), "text": "words", "cells": np.array([1, "x"], object), "table": {"x": 1.0}})
    variables = {variable.name: variable for variable in read_variables(file)}
    assert set(variables) == {"a", "text", "cells", "table"}
    for name in ("text", "cells", "table"):
        with pytest.raises(ValueError, match=f"expected a matrix of numbers, found {name} of class"):
            variables[name].positive()


def test_the_other_order_of_bytes_is_read_too(file: Path) -> None:
    header = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x01\x00MI"
    numbers = [(6, np.array([6, 0], ">u4")), (5, np.array([1, 2], ">i4")), (9, np.array([0.0, 2.0], ">f8"))]
    parts = [(kind, array.tobytes()) for kind, array in numbers]
    parts.insert(2, (1, b"truthfull"))
    body = b"".join(
        kind.to_bytes(4, "big") + len(data).to_bytes(4, "big") + data + bytes(-len(data) % 8) for kind, data in parts
    )
    file.write_bytes(header + (14).to_bytes(4, "big") + len(body).to_bytes(4, "big") + body)
    (variable,) = read_variables(file)
    assert variable.name == "truthfull"
    np.testing.assert_array_equal(variable.positive(), [[False, True]])


@pytest.mark.parametrize("packed", [False, True])
def test_any_damaged_byte_is_an_error_or_changes_nothing_but_numbers(file: Path, packed: bool) -> None:
    savemat(file, {"truth": csc_matrix(np.eye(4)), "full": np.eye(3, dtype=np.uint8)}, do_compression=packed)
    whole, rng, refused = file.read_bytes(), random.Random(0), 0
    for at in range(124, len(whole)):
        damaged = bytearray(whole)
        damaged[at] ^= 1 << rng.randrange(8)
        file.write_bytes(damaged if rng.random() < 0.8 else whole[:at])
        try:
            for variable in read_variables(file):
                assert variable.positive().shape == variable.shape
        except ValueError as error:
            assert "expected" in str(error)  # noqa: PT017 - both outcomes are right
            refused += 1
    assert refused > 50
