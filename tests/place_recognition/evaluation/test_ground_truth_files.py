"""Arrays of a `.npz` file come back, and a damaged or lying file is an error before it takes memory."""

import io
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from place_recognition.evaluation.ground_truth_files import array_names, read_array

per_file = settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
KINDS = st.sampled_from(["?", "u1", "<i2", ">i4", "<f4", ">f8", "<c16", "<U3"])


def npy(header: str, data: bytes, version: bytes = b"\x01\x00") -> bytes:
    """Put together an array file with a header of one's own."""
    return b"\x93NUMPY" + version + struct.pack("<H", len(header)) + header.encode() + data


def write_member(path: Path, data: bytes, compression: int = zipfile.ZIP_STORED) -> Path:
    with zipfile.ZipFile(path, "w", compression) as archive:
        archive.writestr("a.npy", data)
    return path


@per_file
@given(
    value=arrays.arrays(KINDS.map(np.dtype), arrays.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=5)),
    packed=st.booleans(),
    by_columns=st.booleans(),
)
def test_every_array_comes_back(tmp_path: Path, value: np.ndarray, packed: bool, by_columns: bool):
    written = np.array(value, order="F" if by_columns else "C")
    (np.savez_compressed if packed else np.savez)(tmp_path / "a.npz", a=written, b=np.arange(3))
    read = read_array(tmp_path / "a.npz", "a")
    assert read is not None
    assert (read.dtype, read.shape) == (value.dtype, value.shape)
    np.testing.assert_array_equal(read, value)
    assert array_names(tmp_path / "a.npz") == ("a", "b")
    assert read_array(tmp_path / "a.npz", "c") is None


def test_objects_are_never_unpickled(tmp_path: Path):
    np.savez(tmp_path / "a.npz", a=np.array([{"x": 1}], object))
    with pytest.raises(ValueError, match="bytes for"):
        read_array(tmp_path / "a.npz", "a")


@pytest.mark.parametrize("shape", ["(4,)", "(6,)", "(1000000000000000,)", "(2, 1000000000)", "(-5,)"])
def test_a_header_that_states_another_size_than_the_file_has_is_refused(tmp_path: Path, shape: str):
    header = "{'descr': '|u1', 'fortran_order': False, 'shape': " + shape + ", }\n"
    with pytest.raises(ValueError, match="bytes for"):
        read_array(write_member(tmp_path / "a.npz", npy(header, bytes(5))), "a")


def test_a_member_that_states_more_than_the_file_can_hold_is_refused(tmp_path: Path):
    header = "{'descr': '|u1', 'fortran_order': False, 'shape': (5,), }\n"
    path = write_member(tmp_path / "a.npz", npy(header, bytes(5)))
    stated = 10**9  # both in the zip's directory and in the array's header
    longer = npy(header.replace("(5,)", f"({stated},)"), bytes(5))
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.npy", longer)
        archive.infolist()[0].file_size = len(longer) - 5 + stated
    with pytest.raises(ValueError, match="bytes for"):
        read_array(path, "a")


def test_other_versions_of_the_format_are_refused(tmp_path: Path):
    with pytest.raises(ValueError, match="version"):
        read_array(write_member(tmp_path / "a.npz", npy("{}\n", b"", b"\x07\x00")), "a")


def test_a_wrong_checksum_is_refused(tmp_path: Path):
    file = io.BytesIO()
    np.savez(file, a=np.arange(100))
    damaged = bytearray(file.getvalue())
    damaged[damaged.index(struct.pack("<q", 77))] ^= 1
    (tmp_path / "a.npz").write_bytes(damaged)
    with pytest.raises(ValueError, match="CRC"):
        read_array(tmp_path / "a.npz", "a")


@per_file
@given(length=st.integers(0, 300))
def test_a_file_that_was_cut_off_is_refused(tmp_path: Path, length: int):
    file = io.BytesIO()
    np.savez(file, a=np.arange(20))
    (tmp_path / "a.npz").write_bytes(file.getvalue()[:length])
    with pytest.raises(ValueError, match=r"\S"):
        read_array(tmp_path / "a.npz", "a")
