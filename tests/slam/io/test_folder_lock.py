"""One process at a time writes into a folder; a dead one is no obstacle."""

import errno
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from slam.errors import OutputError
from slam.io import folder_lock
from slam.io.folder_lock import LOCK_FILE, FolderLock, check_no_writer
from slam.io.run_folder import RunFolder, unfinished


@contextmanager
def writer(folder: Path) -> Iterator[int]:
    """Another process that is writing a run into the folder; its number."""
    ready, written = os.pipe()
    child = os.fork()
    if child == 0:
        started = RunFolder.create(folder, overwrite=True)
        (started.path / "run.log").write_text("going on")
        os.write(written, b"!")
        signal.pause()
    os.read(ready, 1)
    try:
        yield child
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)


def test_a_folder_in_which_a_live_process_writes_is_refused_and_the_process_is_named(tmp_path: Path) -> None:
    with writer(tmp_path / "out") as other:
        before = sorted(tmp_path.rglob("*"))
        for refused in (lambda: RunFolder.create(tmp_path / "out", True), lambda: check_no_writer(tmp_path / "out")):
            with pytest.raises(OutputError, match=rf"out: another command writes there \(process {other} on .*since"):
                refused()
        assert sorted(tmp_path.rglob("*")) == before  # its staging folder above all


def test_what_a_killed_process_has_left_is_cleaned_by_the_next(tmp_path: Path) -> None:
    with writer(tmp_path / "out"):
        pass
    assert unfinished(tmp_path / "out")
    with RunFolder.create(tmp_path / "out", overwrite=False) as folder:
        (folder.path / "metrics.json").write_text("new")
        folder.commit()
    assert [item.name for item in (tmp_path / "out").iterdir()] == ["metrics.json"]


def test_the_lock_ends_with_the_block_and_leaves_no_file(tmp_path: Path) -> None:
    with FolderLock.acquire(tmp_path), pytest.raises(OutputError, match=f"process {os.getpid()} on"):
        FolderLock.acquire(tmp_path)
    assert list(tmp_path.iterdir()) == []
    FolderLock.acquire(tmp_path).release()


def test_on_a_file_system_without_locks_the_named_process_decides(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unsupported(descriptor: int, operation: int) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    with writer(tmp_path) as other:
        monkeypatch.setattr(folder_lock.fcntl, "flock", unsupported)
        with pytest.raises(OutputError, match=f"process {other} "):
            FolderLock.acquire(tmp_path)
    assert (tmp_path / LOCK_FILE).is_file()
    FolderLock.acquire(tmp_path).release()


def test_a_folder_that_cannot_be_written_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> int:
        raise PermissionError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(folder_lock.os, "open", refuse)
    with pytest.raises(OutputError, match="cannot be written, Read-only file system; choose another folder"):
        RunFolder.create(tmp_path, overwrite=True)
