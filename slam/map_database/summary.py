"""`revisit info`: contents of a map database, and its size by table."""

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Group
from rich.markup import escape
from rich.table import Table

from slam.map_database import schema
from slam.map_database.database import MapDatabase, Session, map_file


@dataclass(frozen=True)
class SessionSummary:
    """One session of a map in numbers.

    Attributes:
        number: number of the session, from 0.
        name: name of the dataset.
        source: path that it was read from; empty where it is not known.
        map_id: sessions of one map id are in one frame of reference.
        first_image: number of its first image, counted through all sessions.
        frames: number of frames.
        finished: True where it has ended and its poses are corrected.
        path_length_m: length of the trajectory, metres, or the unit of a map that one camera has made.
        key_frames: number of frames whose landmarks make the map.
        landmarks: number of landmarks of the key frames.
        candidates: number of beliefs with a match.
        accepted: number of those that the recogniser accepted.
        verified: number of those with a relative pose.
        kept: number of those in the corrected graph; None until the session has ended.
        versions: versions of the libraries with which it was made.
    """

    number: int
    name: str
    source: str
    map_id: int
    first_image: int
    frames: int
    finished: bool
    path_length_m: float
    key_frames: int
    landmarks: int
    candidates: int
    accepted: int
    verified: int
    kept: int | None
    versions: Mapping[str, str]


@dataclass(frozen=True)
class Summary:
    """A map database in numbers.

    Attributes:
        path: path of the file.
        version: version of its tables.
        bytes: size of the file and of its write-ahead log.
        tables: bytes of the rows of each table.
        sessions: its sessions, in order.
    """

    path: str
    version: int
    bytes: int
    tables: Mapping[str, int]
    sessions: tuple[SessionSummary, ...]


def summarize(path: Path) -> Summary:
    """Contents of a map database, or of that of the run in a folder.

    Raises:
        DataError: there is no map, or it is damaged.
    """
    file = map_file(path)
    with MapDatabase.open(file) as store:
        sessions = tuple(_session_summary(store, session) for session in store.sessions())
        files = (file, file.with_name(f"{file.name}-wal"))
        size = sum(one.stat().st_size for one in files if one.is_file())
        return Summary(str(file), schema.VERSION, size, _bytes_by_table(store), sessions)


def _session_summary(store: MapDatabase, session: Session) -> SessionSummary:
    frames = store.images(session.number)
    images = (session.first_image, session.first_image + frames)
    steps = np.diff(store.poses()[slice(*images), :3, 3], axis=0)
    (landmarks,) = store.query(
        "SELECT count(*), total(length(pixels)) / 8 FROM frame JOIN landmark USING (image)"  # two float32 each
        " WHERE key_frame AND session = ?",
        session.number,
    )
    (loops,) = store.query(
        "SELECT count(match), total(accepted), total(outcome = 'closed'), total(kept) FROM loop"
        " WHERE query >= ? AND query < ?",
        *images,
    )
    provenance = session.provenance
    versions = provenance.get("versions", {})
    return SessionSummary(
        number=session.number,
        name=session.name,
        source=str(provenance.get("source", "")),
        map_id=session.map_id,
        first_image=session.first_image,
        frames=frames,
        finished=session.finished,
        path_length_m=float(np.linalg.norm(steps, axis=1).sum()),
        key_frames=landmarks[0],
        landmarks=int(landmarks[1]),
        candidates=loops[0],
        accepted=int(loops[1]),
        verified=int(loops[2]),
        kept=int(loops[3]) if session.finished else None,
        versions=versions if isinstance(versions, dict) else {},
    )


def _bytes_by_table(store: MapDatabase) -> dict[str, int]:
    """Bytes of each table's content: the lengths of all values, without the overhead of SQLite."""
    tables: dict[str, list[str]] = {}
    for name in schema.columns(store.query):
        table, column = name.split(".")
        tables.setdefault(table, []).append(f"coalesce(length({column}), 0)")
    sums = {table: f"SELECT total({' + '.join(lengths)}) FROM {table}" for table, lengths in tables.items()}
    return {table: int(store.query(question)[0][0]) for table, question in sums.items()}


def as_table(summary: Summary) -> Group:
    """The summary as tables for a terminal."""
    shown: list[str | Table] = [escape(f"{summary.path}: {_mb(summary.bytes)}")]
    shown.append(_listed((name, _mb(size)) for name, size in summary.tables.items()))
    for session in summary.sessions:
        state = "finished" if session.finished else f"stopped after {session.frames} frames"
        shown += [escape(f"session {session.number}: {session.name}, {state}"), _listed(_rows(session))]
    return Group(*shown)


def _listed(rows: Iterable[tuple[str, str]]) -> Table:
    table = Table(show_header=False)
    for row in rows:
        table.add_row(*map(escape, row))
    return table


def _rows(session: SessionSummary) -> Iterator[tuple[str, str]]:
    if session.source:
        yield "source", session.source
    yield "frames", f"{session.frames}, from image {session.first_image}, in map {session.map_id}"
    yield "path length", f"{session.path_length_m:.1f} m"
    yield "map", f"{session.landmarks} landmarks in {session.key_frames} key frames"
    kept = "" if session.kept is None else f", {session.kept} kept"
    yield "loops", f"{session.candidates} candidates, {session.accepted} accepted, {session.verified} verified{kept}"
    if session.versions:
        yield "made with", ", ".join(f"{name} {version}" for name, version in session.versions.items())


def _mb(size: int) -> str:
    return f"{size / 1e6:.1f} MB"


def as_json(summary: Summary) -> str:
    """The summary as JSON."""
    table: dict[str, Any] = asdict(summary)
    return json.dumps(table, indent=2)
