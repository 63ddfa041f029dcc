"""A run's folder is complete when it appears, and a failure costs nothing."""

import contextlib
import os
from pathlib import Path

import pytest

from slam.errors import OutputError
from slam.io.run_folder import RunFolder


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def run(path: Path, text: str, overwrite: bool = False) -> None:
    with RunFolder.create(path, overwrite) as folder:
        (folder.path / "metrics.json").write_text(text)
        folder.commit()


@pytest.fixture
def earlier(tmp_path: Path) -> Path:
    """An earlier run with a result that the next will not have, and a file and a folder of the user's own."""
    path = tmp_path / "run"
    run(path, "first")
    (path / "map_before.ply").write_text("cloud")
    (path / "notes.txt").write_text("mine")
    (path / "photos").mkdir()
    (path / "photos" / "a.jpg").write_text("mine")
    return path


@pytest.mark.parametrize("exists", [True, False])
def test_results_appear_at_commit(tmp_path: Path, exists: bool) -> None:
    path = tmp_path / "deep" / "run"
    if exists:
        path.mkdir(parents=True)
    with RunFolder.create(path, overwrite=False) as folder:
        (folder.path / "metrics.json").write_text("x")
        (folder.path / "pictures").mkdir()
        assert not (path / "metrics.json").exists()
        folder.commit()
        assert folder.path == path
    assert sorted(item.name for item in path.iterdir()) == ["metrics.json", "pictures"]


def test_an_earlier_run_is_not_overwritten_unasked(earlier: Path) -> None:
    before = contents(earlier)
    with pytest.raises(OutputError, match=rf"{earlier}: .*found the results of a run; .*--overwrite"):
        RunFolder.create(earlier, overwrite=False)
    assert contents(earlier) == before


def test_a_folder_with_other_files_is_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(OutputError, match=rf"{tmp_path}: .*other files \(thesis.tex, ...\); .*--overwrite"):
        RunFolder.create(tmp_path, overwrite=False)


def test_a_file_cannot_be_the_folder(tmp_path: Path) -> None:
    (tmp_path / "run").touch()
    with pytest.raises(OutputError, match="run: expected a folder, found a file"):
        RunFolder.create(tmp_path / "run", overwrite=True)


def test_a_folder_below_a_file_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="cannot be written, Not a directory"):
        RunFolder.create(tmp_path / "file" / "run", overwrite=False)


def test_overwriting_replaces_results_and_spares_what_others_put_there(earlier: Path) -> None:
    run(earlier, "second", overwrite=True)
    assert contents(earlier) == {"metrics.json": b"second", "notes.txt": b"mine", "photos/a.jpg": b"mine"}


def test_the_earlier_run_stands_until_commit(earlier: Path) -> None:
    with RunFolder.create(earlier, overwrite=True) as folder:
        (folder.path / "metrics.json").write_text("second")
        assert (earlier / "metrics.json").read_text() == "first"
        assert (earlier / "map_before.ply").exists()


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
def test_a_failure_leaves_the_earlier_run_to_the_byte(earlier: Path, error: type[BaseException]) -> None:
    before = contents(earlier)
    with contextlib.suppress(error), RunFolder.create(earlier, overwrite=True) as folder:
        (folder.path / "metrics.json").write_text("half")
        raise error
    assert contents(earlier) == before
    assert sorted(p.name for p in earlier.iterdir()) == [
        "map_before.ply",
        "metrics.json",
        "notes.txt",
        "photos",
    ]


def test_a_failure_leaves_no_new_folder(tmp_path: Path) -> None:
    with contextlib.suppress(ValueError), RunFolder.create(tmp_path / "run", overwrite=False) as folder:
        (folder.path / "metrics.json").write_text("half")
        raise ValueError("bug")
    assert not (tmp_path / "run").exists()


def test_a_failing_commit_moves_everything_back(earlier: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = contents(earlier)
    rename, calls = Path.rename, []

    def failing(source: Path, target: Path) -> Path:
        calls.append(source)
        if len(calls) == 3:  # the first result of the new run, after both of the earlier ones
            raise PermissionError(13, "Permission denied")
        return rename(source, target)

    monkeypatch.setattr(Path, "rename", failing)
    with pytest.raises(OutputError, match="cannot be replaced, Permission denied"):
        run(earlier, "second", overwrite=True)
    assert contents(earlier) == before


def test_an_interrupted_run_may_keep_what_it_has(earlier: Path) -> None:
    with RunFolder.create(earlier, overwrite=True) as folder:
        try:
            (folder.path / "metrics.json").write_text("so far")
            raise KeyboardInterrupt
        except KeyboardInterrupt:
            folder.commit()
    assert (earlier / "metrics.json").read_text() == "so far"


def test_what_a_killed_run_left_does_not_refuse_the_next(tmp_path: Path) -> None:
    child = os.fork()
    if child == 0:
        (RunFolder.create(tmp_path / "run", overwrite=False).path / "run.log").write_text("killed")
        os._exit(0)  # as SIGKILL does, it leaves no time to tidy up
    os.waitpid(child, 0)
    assert len(list((tmp_path / "run").iterdir())) == 2  # what it wrote, and its lock
    run(tmp_path / "run", "next")
    assert (tmp_path / "run" / "metrics.json").read_text() == "next"


def test_a_second_commit_changes_nothing(tmp_path: Path) -> None:
    with RunFolder.create(tmp_path / "run", overwrite=False) as folder:
        (folder.path / "metrics.json").write_text("x")
        folder.commit()
        folder.commit()
    assert contents(tmp_path / "run") == {"metrics.json": b"x"}


def test_an_open_log_goes_on_after_the_move(tmp_path: Path) -> None:
    with (
        RunFolder.create(tmp_path / "run", overwrite=False) as folder,
        (folder.path / "run.log").open("w") as log,
    ):
        log.write("before, ")
        folder.commit()
        log.write("after")
    assert (tmp_path / "run" / "run.log").read_text() == "before, after"
