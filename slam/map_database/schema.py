"""The tables of a map database, its version, and opening one."""

import os
import sqlite3
from collections.abc import Callable, Iterable
from contextlib import closing
from pathlib import Path

from slam.errors import DataError, OutputError

VERSION = 3
APPLICATION = 0x52565354  # "RVST": marks Revisit's files among other SQLite files
_BUSY_S = 5.0  # longest wait for another reader or writer

# Images are numbered through all sessions. Poses, covariances and pixels are little-endian arrays, row by row.
_TABLES = """
CREATE TABLE session (
    number INTEGER PRIMARY KEY,           -- from 0
    first_image INTEGER NOT NULL,
    name TEXT NOT NULL,
    camera TEXT NOT NULL,                 -- JSON: intrinsics, pixels; baseline, metres
    config TEXT NOT NULL,                 -- TOML, as config.toml
    provenance TEXT NOT NULL,             -- JSON: source, recording, command, versions
    finished INTEGER NOT NULL DEFAULT 0,  -- 1 when the session has ended and was optimised
    map_id INTEGER NOT NULL DEFAULT 0     -- sessions of one map id are in one frame of reference
);
CREATE TABLE frame (
    image INTEGER PRIMARY KEY,
    session INTEGER NOT NULL REFERENCES session(number),
    timestamp REAL NOT NULL,              -- seconds
    T_previous_camera BLOB NOT NULL,      -- (4, 4) float64, metres
    covariance BLOB NOT NULL,             -- (6, 6) float64, rotation first
    predicted INTEGER NOT NULL,           -- 1 where the motion could not be measured, and why
    reason TEXT NOT NULL,
    inliers INTEGER NOT NULL,
    tracks INTEGER NOT NULL,
    residual_px REAL,
    key_frame INTEGER NOT NULL,
    T_world_odometry BLOB NOT NULL,       -- (4, 4) float64, of the session's first camera
    T_world_online BLOB NOT NULL,
    T_world_camera BLOB,                  -- corrected; NULL until the session has ended
    unit REAL,                            -- unit of length, as a multiple of the first frame's; 1 with a stereo pair
    stage_ms TEXT NOT NULL                -- JSON
);
CREATE TABLE landmark (
    image INTEGER PRIMARY KEY REFERENCES frame(image),
    pixels BLOB NOT NULL,                 -- (N, 2) float32
    points BLOB NOT NULL,                 -- (N, 3) float32, camera frame, metres
    grey BLOB NOT NULL,                   -- (N,) uint8
    descriptors BLOB NOT NULL             -- (N, D) float16
);
CREATE TABLE loop (
    number INTEGER PRIMARY KEY,           -- in the order of the recogniser's answers
    at_image INTEGER,                     -- the image with which the answer came; NULL for those at the end
    query INTEGER NOT NULL,
    match INTEGER,
    score REAL NOT NULL,
    accepted INTEGER NOT NULL,
    inliers INTEGER,
    verified INTEGER NOT NULL,
    stages TEXT NOT NULL,                 -- JSON: probability, answered_at, and what each earlier stage answered
    pixels BLOB NOT NULL,                 -- (K, 4) float32
    outcome TEXT NOT NULL,                -- '' of a belief that was not accepted, 'closed' or 'rejected' by geometry
    geometry TEXT NOT NULL,               -- JSON: reason, matches, inliers, unit
    T_match_query BLOB,                   -- (4, 4) float64
    covariance BLOB,                      -- (6, 6) float64
    pixels_query BLOB NOT NULL,           -- (K, 2) float32
    pixels_match BLOB NOT NULL,
    kept INTEGER,                         -- 1 where the loop stands in the corrected graph; NULL until the end
    weight REAL,
    residual REAL,
    final_reason TEXT                     -- why it was kept or left out
);
CREATE INDEX loop_at_image ON loop(at_image);
CREATE TABLE checkpoint (
    session INTEGER PRIMARY KEY REFERENCES session(number),
    frames INTEGER NOT NULL,              -- of the session, that the components have processed
    structure TEXT NOT NULL,              -- JSON: states of recogniser, odometry, key frames and similarity matrix
    digest BLOB NOT NULL                  -- of the structure
);
CREATE TABLE checkpoint_array (
    session INTEGER NOT NULL,
    number INTEGER NOT NULL,
    dtype TEXT NOT NULL,
    shape TEXT NOT NULL,
    layout TEXT NOT NULL,                 -- 'C' or 'F'
    chunks BLOB NOT NULL,                 -- digests of its chunks, one after the other
    PRIMARY KEY (session, number)
) WITHOUT ROWID;
CREATE TABLE chunk (
    digest BLOB PRIMARY KEY,
    bytes BLOB NOT NULL
);
"""

_COLUMNS = """
SELECT tables.name || '.' || columns.name FROM sqlite_master AS tables, pragma_table_info(tables.name) AS columns
WHERE tables.type = 'table' AND tables.name NOT LIKE 'sqlite_%'
"""


def create(path: Path) -> sqlite3.Connection:
    """Create an empty database.

    Raises:
        OutputError: the file cannot be written.
    """
    try:
        connection = _connect(f"{path.resolve().as_uri()}?mode=rwc")
        marks = f"PRAGMA application_id = {APPLICATION}; PRAGMA user_version = {VERSION};"
        connection.executescript(f"BEGIN; {marks} {_TABLES} COMMIT;")
    except sqlite3.Error as error:
        raise OutputError(f"{path}: the map cannot be written ({error}); make room or choose another folder") from error
    return connection


def connect(path: Path, mode: str = "ro") -> sqlite3.Connection:
    """Open a database, "ro" to read or "rw" to write.

    Raises:
        DataError: no such file, no map database, a damaged one, or one of another version.
    """
    if not path.is_file():
        raise DataError(f"{path}: expected a map database, found none; a run writes one: revisit run SOURCE --out DIR")
    try:
        connection = _connect(f"{path.resolve().as_uri()}?mode={mode}{_untouched(path) if mode == 'ro' else ''}")
        (application,) = connection.execute("PRAGMA application_id").fetchone()
        (version,) = connection.execute("PRAGMA user_version").fetchone()
    except sqlite3.Error as error:
        raise damaged(path, error) from error
    if application != APPLICATION:
        connection.close()
        raise DataError(f"{path}: expected a map database, found another SQLite database; give the map.db of a run")
    if version != VERSION:
        connection.close()
        raise DataError(f"{path}: expected a map database of version {VERSION}, found version {version}; run again")
    return connection


def _untouched(path: Path) -> str:
    """SQLite's option for a file that nobody writes: else it needs a log beside the file, even on a read-only disk."""
    log = path.with_name(f"{path.name}-wal")
    waiting = log.is_file() and log.stat().st_size > 0
    return "" if waiting or os.access(path.parent, os.W_OK) else "&immutable=1"


def columns(query: Callable[[str], Iterable[sqlite3.Row]]) -> list[str]:
    """Columns of a database as `table.column`; `query` reads from it."""
    return [row[0] for row in query(_COLUMNS)]


def missing_columns(query: Callable[[str], Iterable[sqlite3.Row]]) -> list[str]:
    """Columns that a database lacks."""
    with closing(sqlite3.connect(":memory:")) as empty:
        empty.executescript(_TABLES)
        expected = columns(empty.execute)
    found = set(columns(query))
    return [name for name in expected if name not in found]


def damaged(path: Path, error: Exception) -> DataError:
    """The error for a database that cannot be read."""
    return DataError(f"{path}: expected a map database, found a damaged one ({error}); copy it again or run again")


def _connect(uri: str) -> sqlite3.Connection:
    connection = sqlite3.connect(uri, uri=True, timeout=_BUSY_S, isolation_level=None, check_same_thread=False)
    connection.row_factory = sqlite3.Row
    if "mode=ro" not in uri:
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = NORMAL")  # survives a crash of the program, but not of the machine
        connection.execute("PRAGMA foreign_keys = ON")
    return connection
