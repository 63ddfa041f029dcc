"""`revisit info`: what a saved map holds, and where its bytes are."""

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Group
from rich.markup import escape
from rich.table import Table

from slam.map_store import schema
from slam.map_store.store import MapDatabase, Session, map_file


@dataclass(frozen=True)
class SessionSummary:
    """One drive of a map.

    Attributes:
        number: from 0.
        name: of the recording.
        source: that it was read from; empty where that is not known.
        map_id: sessions of one map id are in one frame of reference.
        first_image: number of its first image through all drives.
        frames: how many there are.
        finished: it was driven to its end, and the poses are corrected.
        way_m: length of the way, metres, or the unit of a map that one camera has made.
        key_frames: whose landmarks make the map.
        landmarks: of these.
        answers: of the recogniser, those with a match.
        accepted: of these, taken for revisits.
        closed: of these, those that geometry proved.
        kept: of these, those that stand in the corrected map; None until the drive has ended.
        versions: of what it was made with.
    """

    number: int
    name: str
    source: str
    map_id: int
    first_image: int
    frames: int
    finished: bool
    way_m: float
    key_frames: int
    landmarks: int
    answers: int
    accepted: int
    closed: int
    kept: int | None
    versions: Mapping[str, str]


@dataclass(frozen=True)
class Summary:
    """A map in numbers.

    Attributes:
        path: of the store.
        version: of its tables.
        bytes: of the file, and of what waits in its log.
        tables: bytes of what each holds.
        drives: in order.
    """

    path: str
    version: int
    bytes: int
    tables: Mapping[str, int]
    drives: tuple[SessionSummary, ...]


def summarise(path: Path) -> Summary:
    """What a map store holds, or that of the run in a folder.

    Raises:
        DataError: there is none, or it is damaged.
    """
    file = map_file(path)
    with MapDatabase.open(file) as store:
        drives = tuple(_drive(store, session) for session in store.sessions())
        files = (file, file.with_name(f"{file.name}-wal"))
        size = sum(one.stat().st_size for one in files if one.is_file())
        return Summary(str(file), schema.VERSION, size, _bytes_by_table(store), drives)


def _drive(store: MapDatabase, session: Session) -> SessionSummary:
    frames = store.images(session.number)
    images = (session.first_image, session.first_image + frames)
    steps = np.diff(store.poses()[slice(*images), :3, 3], axis=0)
    (seen,) = store.ask(
        "SELECT count(*), total(length(pixels)) / 8 FROM frame JOIN landmark USING (image)"  # two float32 each
        " WHERE key_frame AND session = ?",
        session.number,
    )
    (answers,) = store.ask(
        "SELECT count(match), total(accepted), total(outcome = 'closed'), total(kept) FROM candidate"
        " WHERE query >= ? AND query < ?",
        *images,
    )
    made = session.provenance
    versions = made.get("versions", {})
    return SessionSummary(
        number=session.number,
        name=session.name,
        source=str(made.get("source", "")),
        map_id=session.map_id,
        first_image=session.first_image,
        frames=frames,
        finished=session.finished,
        way_m=float(np.linalg.norm(steps, axis=1).sum()),
        key_frames=seen[0],
        landmarks=int(seen[1]),
        answers=answers[0],
        accepted=int(answers[1]),
        closed=int(answers[2]),
        kept=int(answers[3]) if session.finished else None,
        versions=versions if isinstance(versions, dict) else {},
    )


def _bytes_by_table(store: MapDatabase) -> dict[str, int]:
    """Bytes of what the rows hold: the lengths of all values, without SQLite's own pages."""
    tables: dict[str, list[str]] = {}
    for name in schema.columns(store.ask):
        table, column = name.split(".")
        tables.setdefault(table, []).append(f"coalesce(length({column}), 0)")
    sums = {table: f"SELECT total({' + '.join(lengths)}) FROM {table}" for table, lengths in tables.items()}
    return {table: int(store.ask(question)[0][0]) for table, question in sums.items()}


def as_table(summary: Summary) -> Group:
    """The numbers for people."""
    shown: list[str | Table] = [escape(f"{summary.path}: {_mb(summary.bytes)}")]
    shown.append(_listed((name, _mb(size)) for name, size in summary.tables.items()))
    for drive in summary.drives:
        state = "finished" if drive.finished else f"stopped after {drive.frames} frames"
        shown += [escape(f"drive {drive.number}: {drive.name}, {state}"), _listed(_rows(drive))]
    return Group(*shown)


def _listed(rows: Iterable[tuple[str, str]]) -> Table:
    table = Table(show_header=False)
    for row in rows:
        table.add_row(*map(escape, row))
    return table


def _rows(drive: SessionSummary) -> Iterator[tuple[str, str]]:
    if drive.source:
        yield "source", drive.source
    yield "frames", f"{drive.frames}, from image {drive.first_image}, in map {drive.map_id}"
    yield "way", f"{drive.way_m:.1f} m"
    yield "map", f"{drive.landmarks} landmarks in {drive.key_frames} key frames"
    kept = "" if drive.kept is None else f", {drive.kept} kept"
    yield "loops", f"{drive.answers} answers, {drive.accepted} accepted, {drive.closed} closed{kept}"
    if drive.versions:
        yield "made with", ", ".join(f"{name} {version}" for name, version in drive.versions.items())


def _mb(size: int) -> str:
    return f"{size / 1e6:.1f} MB"


def as_json(summary: Summary) -> str:
    """The numbers for scripts."""
    table: dict[str, Any] = asdict(summary)
    return json.dumps(table, indent=2)
