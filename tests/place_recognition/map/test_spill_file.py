"""Records that are spilled to disk, and erased ones, which cost nothing."""

import numpy as np
import pytest

from place_recognition.growing_array import SpillFile

DTYPE = np.dtype([("number", "i4"), ("values", "f8", 100)])
IN_MEMORY = 4


def record(number: int) -> np.ndarray:
    made = np.zeros((), DTYPE)
    made["number"], made["values"] = number, number + np.arange(100)
    return made


def filled(count: int, erased: tuple[int, ...] = (), at_once: bool = True) -> SpillFile:
    """Records 1, 2, ..., erased as soon as they are there or at the end."""
    file = SpillFile(DTYPE, IN_MEMORY)
    for k in range(count):
        file.append(record(k + 1))
        if at_once and k in erased:
            file.erase(k)
    if not at_once:
        for k in erased:
            file.erase(k)
    return file


@pytest.mark.parametrize("at_once", [True, False])
def test_an_erased_record_reads_as_zeros_and_the_others_stay(at_once: bool) -> None:
    file = filled(12, (0, 5, 11), at_once)
    found = [int(file.read(k)["number"]) for k in range(12)]
    assert found == [0, 2, 3, 4, 5, 0, 7, 8, 9, 10, 11, 0]
    np.testing.assert_array_equal(file.state()["number"], found)
    assert file.read(5)["values"].sum() == 0


def test_what_is_erased_in_time_takes_no_room_on_the_disk() -> None:
    assert filled(104).disk_bytes == 100 * DTYPE.itemsize
    assert filled(104, tuple(range(10, 100))).disk_bytes == 10 * DTYPE.itemsize


def test_a_restored_file_has_the_same_records_and_holes() -> None:
    file, other = filled(30, (3, 20, 28)), SpillFile(DTYPE, IN_MEMORY)
    other.restore(file.state())
    np.testing.assert_array_equal(other.state(), file.state())
    assert other.disk_bytes == file.disk_bytes
