"""`revisit info` and `revisit check` of a saved map: right numbers, and every fault named."""

import json
import sqlite3
from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path

import numpy as np
import pytest

from slam.cli import app
from slam.diagnostics.findings import MapUse, Status
from slam.diagnostics.map_checks import inspect_map, is_map
from slam.errors import DataError
from slam.localization.keyframe_map import SavedMap
from slam.map_database import schema
from slam.map_database.database import MapDatabase
from slam.map_database.summary import as_json, summarize


def faults(path: Path) -> dict[str, str]:
    inspection = inspect_map(path)
    return {finding.topic: finding.text for finding in inspection.findings if finding.status is Status.FAULT}


def read_all(path: Path) -> None:
    with MapDatabase.open(path) as store:
        SavedMap.open(store)
        list(store.frames())


def change(path: Path, statement: str, *values: object) -> None:
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute(statement, values)


def test_the_summary_counts_the_rows(map_path: Path) -> None:
    summary = summarize(map_path)
    with MapDatabase.open(map_path) as store:
        frames, candidates = list(store.frames()), list(store.loops())
    (drive,) = summary.sessions
    keys = [frame for frame in frames if frame.is_key_frame]
    assert (drive.frames, drive.key_frames) == (len(frames), len(keys))
    assert drive.landmarks == sum(len(frame.landmarks) for frame in keys)
    assert drive.candidates == sum(candidate.belief.match is not None for candidate in candidates)
    assert drive.path_length_m == pytest.approx(2.0 * (len(frames) - 1), rel=0.05)  # every second metre of the drive
    assert drive.finished
    assert summary.bytes == map_path.stat().st_size
    assert 0.5 * summary.bytes < sum(summary.tables.values()) < summary.bytes
    sizes = {"landmark": sum(len(f.landmarks) * (8 + 12 + 1 + 2 * 64) for f in frames)}
    assert summary.tables["landmark"] == pytest.approx(sizes["landmark"], abs=len(frames) * 4)
    assert json.loads(as_json(summary))["sessions"][0]["versions"] == {"revisit-slam": "0"}


def test_a_sound_map_passes_every_check(map_path: Path) -> None:
    for path in (map_path, map_path.parent):
        assert is_map(path)
        inspection = inspect_map(path)
        assert inspection.possible_uses == tuple(MapUse)
        assert {finding.status for finding in inspection.findings} == {Status.OK}


def _blob(path: Path, column: str, table: str, at: int, number: float) -> None:
    """Put a number into the array of image 3."""
    with closing(sqlite3.connect(path)) as connection, connection:
        (old,) = connection.execute(f"SELECT {column} FROM {table} WHERE image = 3").fetchone()
        array = np.frombuffer(old, {"T_world_camera": "<f8", "descriptors": "<f2"}.get(column, "<f4")).copy()
        array[at] = number
        connection.execute(f"UPDATE {table} SET {column} = ? WHERE image = 3", (array.tobytes(),))


UNTRUE: dict[str, tuple[Callable[[Path], None], str, str]] = {
    "a matrix that turns nothing": (
        lambda path: _blob(path, "T_world_camera", "frame", 0, 2.0),
        "frames",
        "image 3: expected poses with rotation",
    ),
    "a pose that is none": (
        lambda path: _blob(path, "T_world_camera", "frame", 3, np.nan),
        "frames",
        "image 3: expected poses",
    ),
    "a landmark nowhere": (
        lambda path: _blob(path, "points", "landmark", 0, np.inf),
        "frames",
        "image 3: expected finite",
    ),
    "a long descriptor": (lambda path: _blob(path, "descriptors", "landmark", 0, 7.0), "frames", "of unit length"),
    "an array cut short": (
        lambda path: change(path, "UPDATE landmark SET points = x'00112233' WHERE image = 3"),
        "frames",
        "damaged",
    ),
    "lost landmarks": (
        lambda path: change(path, "DELETE FROM landmark WHERE image = 5"),
        "frames",
        "image 5 is missing",
    ),
    "a frame of no drive": (
        lambda path: change(path, "UPDATE frame SET session = 9 WHERE image = 3"),
        "tables",
        "session",
    ),
    "an answer about nothing": (
        lambda path: change(path, "UPDATE loop SET query = 999 WHERE number = 0"),
        "loops",
        "found 999",
    ),
    "a lost column": (
        lambda path: change(path, "ALTER TABLE loop DROP COLUMN weight"),
        "tables",
        "loop.weight",
    ),
    "settings of another kind": (lambda path: change(path, "UPDATE session SET camera = '[1]'"), "drives", "damaged"),
    "no drive": (lambda path: change(path, "DELETE FROM session"), "drives", "expected a drive, found none"),
}


@pytest.mark.parametrize("fault", UNTRUE)
def test_impossible_values_are_found(damaged: Path, fault: str) -> None:
    harm, topic, words = UNTRUE[fault]
    assert faults(damaged) == {}
    harm(damaged)
    assert words in faults(damaged)[topic]
    assert MapUse.LOCATE not in inspect_map(damaged).possible_uses


def test_a_damaged_checkpoint_prevents_resuming_only(damaged: Path) -> None:
    change(damaged, "UPDATE chunk SET bytes = zeroblob(length(bytes)) WHERE rowid = 2")
    assert "chunk of the checkpoint" in faults(damaged)["checkpoint"]
    assert inspect_map(damaged).possible_uses == (MapUse.LOCATE,)


NO_MAPS: dict[str, tuple[Callable[[Path], object], str]] = {
    "empty": (lambda path: path.write_bytes(b""), "found another SQLite database"),
    "cut short": (lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 3]), "damaged"),
    "text": (lambda path: path.write_text("no database" * 1000), "found a damaged one"),
    "gone": (lambda path: path.unlink(), "found none"),
    "a folder": (lambda path: (path.unlink(), path.mkdir()), "found none"),
    "another database": (
        lambda path: (path.unlink(), change(path, "CREATE TABLE mine (x)")),
        "found another SQLite database",
    ),
    "another version": (lambda path: change(path, "PRAGMA user_version = 99"), "expected a map database of version"),
}


@pytest.mark.parametrize("kind", NO_MAPS)
def test_files_that_are_no_map_are_refused_in_one_line(damaged: Path, kind: str) -> None:
    harm, words = NO_MAPS[kind]
    harm(damaged)
    path = damaged / "map.db" if damaged.is_dir() else damaged
    assert any(words in text for text in faults(path).values())
    with pytest.raises(DataError, match=words) as error:
        read_all(path)
    assert "\n" not in str(error.value)
    with pytest.raises(DataError, match=words):
        summarize(path)


def test_flipped_bytes_never_end_in_a_traceback(damaged: Path) -> None:
    rng, sound = np.random.default_rng(0), damaged.read_bytes()
    for _ in range(25):
        content = np.frombuffer(sound, np.uint8).copy()
        content[rng.integers(0, 100, 2)] = rng.integers(0, 256, 2)  # the header
        at = 4096 * rng.integers(1, len(content) // 4096)
        content[at : at + 64] = rng.integers(0, 256, 64)  # the head of a page
        damaged.write_bytes(content.tobytes())
        inspect_map(damaged)
        with suppress(DataError):
            summarize(damaged)


def test_a_map_is_read_while_it_is_written(damaged: Path) -> None:
    with MapDatabase.open(damaged, writable=True) as writer, writer.writing():
        writer.delete_loops_from(0)
        assert faults(damaged) == {}
        assert summarize(damaged).sessions[0].frames == 45


def test_a_map_on_a_disk_that_nobody_can_write_to_is_read(damaged: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.access", lambda path, mode: False)
    with MapDatabase.open(damaged) as store:
        assert store.images() == 45
        assert [item.name for item in damaged.parent.iterdir()] == ["map.db"]  # no log beside it, as SQLite would make
    monkeypatch.undo()
    with MapDatabase.open(damaged, writable=True) as writer:
        with writer.writing():
            writer.delete_loops_from(0)
        monkeypatch.setattr("os.access", lambda path, mode: False)
        with MapDatabase.open(damaged) as store:
            assert store.count("loop") == 0  # what still waits in the log is read


def test_commands_print_a_table_or_json(
    map_path: Path, damaged: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def run(*arguments: object) -> tuple[int, str]:
        monkeypatch.setattr("sys.argv", ["revisit", *map(str, arguments)])
        with pytest.raises(SystemExit) as exit_:
            app.main()
        return int(exit_.value.code or 0), capsys.readouterr().out

    monkeypatch.setenv("COLUMNS", "150")
    code, shown = run("info", map_path.parent)
    assert code == 0
    assert "landmarks in 45 key frames" in shown
    assert json.loads(run("info", map_path, "--json")[1])["version"] == schema.VERSION
    code, shown = run("check", map_path)
    assert code == 0
    assert "revisit locate: will work" in shown
    damaged.write_bytes(b"SQLite format 3\0")
    code, shown = run("check", damaged, "--json")
    assert code == 1
    assert json.loads(shown)["works"] == {"locate": False, "resume": False}
