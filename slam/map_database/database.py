"""The map database: one SQLite file, written during a run, which other processes may read at any time.

A checkpoint and the frames up to it are committed together: if the writer is killed, the database holds a session
that stopped at its last checkpoint. Decision record: docs/decisions/map_database.md.
"""

import json
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from odometry.camera import StereoCamera
from slam.errors import OutputError
from slam.frame_record import FrameRecord, LoopRecord
from slam.loop_closing.loop_closer import FrameLandmarks
from slam.map_database import schema
from slam.map_database.checkpoint import deserialize, digest, read_arrays, serialize, write_arrays
from slam.map_database.records import (
    frame_row,
    landmark_row,
    landmark_values,
    loop_row,
    pack,
    read_frame,
    read_landmarks,
    read_loop,
    unpack,
)

Array = NDArray[np.float64]

MAP_FILE = "map.db"

# What reading a damaged file can raise; a state that does not fit raises the same (`PlaceRecognizer.restore`).
_DAMAGE = (sqlite3.Error, ValueError, LookupError, TypeError, AttributeError, OverflowError, RecursionError)


@dataclass(frozen=True)
class Session:
    """One session of a map: one run over a dataset.

    Attributes:
        number: number of the session, from 0.
        first_image: number of its first image, counted through all sessions.
        name: name of the dataset.
        camera: camera of its left images, with the pair's baseline.
        config: settings as TOML, as in `config.toml`.
        provenance: source, recording, command and versions.
        finished: True when it has ended and was optimised.
        map_id: sessions with the same number are in one frame of reference.
    """

    number: int
    first_image: int
    name: str
    camera: StereoCamera
    config: str
    provenance: Mapping[str, Any]
    finished: bool = False
    map_id: int = 0


@dataclass(frozen=True)
class Checkpoint:
    """State of the components after a number of frames of a session.

    Attributes:
        frames: number of frames of the session that the components have processed.
        state: nested dicts, lists, plain values and arrays (`slam.map_database.checkpoint`).
    """

    frames: int
    state: Any


class LoopOutcome(NamedTuple):
    """Result of the final optimisation for a loop: whether it was kept, its weight and residual, and why."""

    kept: bool
    weight: float
    residual: float
    reason: str


@dataclass(frozen=True)
class OptimizedSession:
    """Result of the final optimisation.

    Attributes:
        images: (N,) numbers of the images.
        poses: (N, 4, 4) T_world_camera of the images.
        units: (N,) unit of length of each image, as a multiple of that of the first frame.
        outcomes: results for the verified loops, by the numbers of their records.
        map_id: frame of reference of the poses, by the number of its first session.
    """

    images: NDArray[np.int64]
    poses: Array
    units: Array
    outcomes: Mapping[int, LoopOutcome]
    map_id: int = 0


class MapDatabase:
    """Reads and writes one map database. Every method is one transaction, or part of the one that `writing` opens."""

    def __init__(self, connection: sqlite3.Connection, path: Path, writable: bool) -> None:
        self._connection, self.path, self._writable = connection, path, writable

    @classmethod
    def create(cls, path: Path) -> Self:
        """Create an empty database.

        Raises:
            OutputError: the file cannot be written.
        """
        return cls(schema.create(path), path, writable=True)

    @classmethod
    def open(cls, path: Path, writable: bool = False) -> Self:
        """Open an existing database.

        Raises:
            DataError: no such file, no map database, a damaged one, or one of another version.
        """
        return cls(schema.connect(path, "rw" if writable else "ro"), path, writable)

    def close(self) -> None:
        """Close the database; its write-ahead log is merged into the one file."""
        if self._writable:
            with suppress(sqlite3.Error):  # another process reads it: the log stays
                self._connection.execute("PRAGMA journal_mode = DELETE")
        self._connection.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Write everything in the block in one transaction: all of it, or nothing if it fails.

        Raises:
            OutputError: the disk is full, or the file cannot be written for another reason.
        """
        try:
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                yield
            except BaseException:
                if self._connection.in_transaction:  # a full disk has rolled it back already
                    self._connection.execute("ROLLBACK")
                raise
            self._connection.execute("COMMIT")
        except sqlite3.Error as error:
            raise OutputError(
                f"{self.path}: the map cannot be written ({error}); make room, then continue with --resume"
            ) from error

    @contextmanager
    def reading(self) -> Iterator[None]:
        """Turn every error that a damaged file causes in the block into a DataError of one line.

        Raises:
            DataError: the file is damaged.
        """
        try:
            yield
        except _DAMAGE as error:
            raise schema.damaged(self.path, error) from error

    def add_session(self, session: Session) -> None:
        """Begin a session; call within `writing`."""
        values = {
            "number": session.number,
            "first_image": session.first_image,
            "name": session.name,
            "camera": json.dumps(asdict(session.camera)),
            "config": session.config,
            "provenance": json.dumps(session.provenance, default=str),
            "finished": session.finished,
            "map_id": session.map_id,
        }
        self._insert("session", values)

    def add_frame(self, frame: FrameRecord, session: int) -> None:
        """Add a frame with its landmarks; call within `writing`."""
        self._insert("frame", frame_row(frame, session))
        self._insert("landmark", landmark_row(frame))

    def thin_frame(self, image: int, count: int) -> None:
        """Keep the strongest landmarks of a frame, which is no key frame any more; call within `writing`."""
        self._connection.execute("UPDATE frame SET key_frame = 0 WHERE image = ?", (image,))
        values = landmark_values(self.landmarks(image).strongest(count))
        names = ", ".join(f"{name} = ?" for name in values)
        self._connection.execute(f"UPDATE landmark SET {names} WHERE image = ?", (*values.values(), image))

    def add_loop(self, number: int, loop: LoopRecord) -> None:
        """Add the record of a loop candidate; call within `writing`."""
        self._insert("loop", loop_row(number, loop))

    def set_checkpoint(self, session: int, checkpoint: Checkpoint) -> None:
        """Replace the checkpoint of a session; call within `writing`."""
        structure, arrays = serialize(checkpoint.state)
        text = json.dumps(structure, separators=(",", ":"), allow_nan=False)
        values = (session, checkpoint.frames, text, digest(text.encode()))
        self._connection.execute("INSERT OR REPLACE INTO checkpoint VALUES (?, ?, ?, ?)", values)
        write_arrays(self._connection, session, arrays)

    def delete_loops_from(self, begin: int) -> None:
        """Delete the loop records from a number on; call within `writing`."""
        self._connection.execute("DELETE FROM loop WHERE number >= ?", (begin,))

    def finish(self, session: int, corrected: OptimizedSession, ended: bool) -> None:
        """Write the final poses and loop outcomes; call within `writing`."""
        poses = [
            (pack(T, "<f8"), float(unit), int(image))
            for image, T, unit in zip(corrected.images, corrected.poses, corrected.units, strict=True)
        ]
        self._connection.executemany("UPDATE frame SET T_world_camera = ?, unit = ? WHERE image = ?", poses)
        outcomes = [(*_plain(outcome), number) for number, outcome in corrected.outcomes.items()]
        self._connection.executemany(
            "UPDATE loop SET kept = ?, weight = ?, residual = ?, final_reason = ? WHERE number = ?", outcomes
        )
        closing_row = "UPDATE session SET finished = ?, map_id = ? WHERE number = ?"
        self._connection.execute(closing_row, (ended, corrected.map_id, session))

    def sessions(self) -> tuple[Session, ...]:
        """All sessions of the map, in order.

        Raises:
            DataError: the database is damaged; all methods that read raise this.
        """
        with self.reading():
            rows = self._connection.execute("SELECT * FROM session ORDER BY number").fetchall()
            return tuple(_session(row) for row in rows)

    def images(self, session: int | None = None) -> int:
        """Number of images, in all or of one session."""
        return self._count("frame", session)

    def frames(self, first_image: int = 0) -> Iterator[FrameRecord]:
        """All frames from an image on with their landmarks, in order, read on demand."""
        with self.reading():
            joined = "SELECT frame.*, pixels, points, grey, descriptors FROM frame JOIN landmark USING (image)"
            for row in self._connection.execute(f"{joined} WHERE image >= ? ORDER BY image", (first_image,)):
                yield read_frame(row, read_landmarks(row))

    def poses(self) -> Array:
        """T_world_camera (N, 4, 4) of all images, corrected where they have been, else as they were online."""
        with self.reading():
            best = "SELECT coalesce(T_world_camera, T_world_online) FROM frame ORDER BY image"
            content = b"".join(row[0] for row in self._connection.execute(best))
            return unpack(content, "<f8", -1, 4, 4)

    def units(self) -> Array:
        """Unit of length (N,) of each image, as a multiple of that of the first."""
        with self.reading():
            found = self._connection.execute("SELECT coalesce(unit, 1) FROM frame ORDER BY image")
            return np.array([row[0] for row in found], np.float64)

    def timestamps(self, session: int) -> Array:
        """Seconds (N,) of all images of a session."""
        with self.reading():
            wanted = "SELECT timestamp FROM frame WHERE session = ? ORDER BY image"
            found = self._connection.execute(wanted, (session,))
            return np.array([row[0] for row in found])

    def key_frames(self) -> tuple[int, ...]:
        """Numbers of the images whose landmarks make the map."""
        with self.reading():
            found = self._connection.execute("SELECT image FROM frame WHERE key_frame ORDER BY image")
            return tuple(row[0] for row in found)

    def landmarks(self, image: int) -> FrameLandmarks:
        """Landmarks of one image.

        Raises:
            DataError: there is no such image.
        """
        with self.reading():
            row = self._connection.execute("SELECT * FROM landmark WHERE image = ?", (image,)).fetchone()
            if row is None:
                raise ValueError(f"image {image} is missing")
            return read_landmarks(row)

    def steps(self) -> list[tuple[Array, Array]]:
        """Motion since the previous frame (4, 4) and its covariance (6, 6), of all images in order."""
        with self.reading():
            found = self._connection.execute("SELECT T_previous_camera, covariance FROM frame ORDER BY image")
            return [(unpack(T, "<f8", 4, 4), unpack(covariance, "<f8", 6, 6)) for T, covariance in found]

    def loops(self, first_image: int = 0) -> Iterator[LoopRecord]:
        """Records of the loop candidates of all images from that one on, in the order in which they came."""
        with self.reading():
            wanted = "SELECT * FROM loop WHERE query >= ? ORDER BY number"
            for row in self._connection.execute(wanted, (first_image,)):
                yield read_loop(row)

    def checkpoint(self, session: int) -> Checkpoint | None:
        """The last checkpoint of a session; None before the first."""
        with self.reading():
            found = self._connection.execute("SELECT * FROM checkpoint WHERE session = ?", (session,)).fetchone()
            if found is None:
                return None
            if digest(found["structure"].encode()) != found["digest"]:
                raise ValueError("the structure of the checkpoint is damaged")
            arrays = read_arrays(self._connection, session)
            return Checkpoint(found["frames"], deserialize(json.loads(found["structure"]), arrays))

    def query(self, sql: str, *values: Any) -> list[sqlite3.Row]:
        """Rows of an SQL query, where no other method gives them."""
        with self.reading():
            return self._connection.execute(sql, values).fetchall()

    def copy(self, target: Path) -> None:
        """Write the whole database, as it is now, into another file.

        Raises:
            OutputError: it cannot be written.
        """
        try:
            with closing(sqlite3.connect(target)) as connection:
                self._connection.backup(connection)
        except sqlite3.Error as error:
            raise OutputError(f"{target}: the map cannot be copied ({error}); make room") from error

    def num_loops_before(self, image: int) -> int:
        """Number of loop records of the images before one."""
        with self.reading():
            (count,) = self._connection.execute("SELECT count(*) FROM loop WHERE query < ?", (image,)).fetchone()
            return int(count)

    def count(self, table: str) -> int:
        """Number of rows of a table."""
        return self._count(table, None)

    def _count(self, table: str, session: int | None) -> int:
        where, values = ("", ()) if session is None else (" WHERE session = ?", (session,))
        with self.reading():
            (count,) = self._connection.execute(f"SELECT count(*) FROM {table}{where}", values).fetchone()
            return int(count)

    def _insert(self, table: str, values: Mapping[str, Any]) -> None:
        names, marks = ", ".join(values), ", ".join("?" * len(values))
        self._connection.execute(f"INSERT INTO {table} ({names}) VALUES ({marks})", _plain(values.values()))


def map_file(path: Path) -> Path:
    """The map database that a path names: itself, or that of the run in a folder."""
    return path / MAP_FILE if path.is_dir() else path


def _plain(values: Iterable[Any]) -> Sequence[Any]:
    return [value.item() if isinstance(value, np.generic) else value for value in values]


def _session(row: sqlite3.Row) -> Session:
    return Session(
        number=row["number"],
        first_image=row["first_image"],
        name=row["name"],
        camera=StereoCamera(**json.loads(row["camera"])),
        config=row["config"],
        provenance=json.loads(row["provenance"]),
        finished=bool(row["finished"]),
        map_id=row["map_id"],
    )
