"""A file is there whole, or as it was before."""

import contextlib
import os
from pathlib import Path

import pytest

from slam.errors import OutputError
from slam.io.files import atomic_writer, check_output_file, replacing


def names(folder: Path) -> list[str]:
    return sorted(item.name for item in folder.iterdir())


def test_the_file_appears_when_the_block_ends(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    with atomic_writer(path) as file:
        file.write("größer\n")
        assert not path.exists()
    assert path.read_bytes() == "größer\n".encode()
    assert names(tmp_path) == ["a.txt"]


def test_bytes_are_written_as_they_are(tmp_path: Path) -> None:
    with atomic_writer(tmp_path / "a.bin", "wb") as file:
        file.write(b"\r\n\x00")
    assert (tmp_path / "a.bin").read_bytes() == b"\r\n\x00"


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_a_failure_leaves_the_earlier_file(tmp_path: Path, error: type[BaseException]) -> None:
    path = tmp_path / "a.txt"
    path.write_text("before")
    with contextlib.suppress(error), atomic_writer(path) as file:
        file.write("half")
        raise error
    assert path.read_text() == "before"
    assert names(tmp_path) == ["a.txt"]


def test_a_full_disk_is_the_users_to_mend(tmp_path: Path) -> None:
    message = r"a.txt: cannot be written, No space left.*make room"
    with pytest.raises(OutputError, match=message), atomic_writer(tmp_path / "a.txt"):
        raise OSError(28, "No space left on device")
    assert names(tmp_path) == []


def test_the_temporary_path_keeps_the_suffix(tmp_path: Path) -> None:
    with replacing(tmp_path / "map.ply") as temporary:
        temporary.write_text("ply")
        assert (temporary.suffix, temporary.parent) == (".ply", tmp_path)
    assert names(tmp_path) == ["map.ply"]


def test_files_have_the_usual_permissions(tmp_path: Path) -> None:
    (tmp_path / "usual").touch()
    with atomic_writer(tmp_path / "a.txt"):
        pass
    assert (tmp_path / "a.txt").stat().st_mode == (tmp_path / "usual").stat().st_mode


def test_a_file_that_cannot_be_written_is_known_beforehand(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    check_output_file(tmp_path / "new.csv")
    for path, found in ((tmp_path, "found a folder"), (tmp_path / "no" / "a.csv", "found no such folder")):
        with pytest.raises(OutputError, match=found):
            check_output_file(path)
    monkeypatch.setattr(os, "access", lambda folder, mode: folder != tmp_path)  # root may write everywhere
    with pytest.raises(OutputError, match=r"a\.csv: expected a folder that may be written, found a read-only one"):
        check_output_file(tmp_path / "a.csv")
