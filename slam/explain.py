"""`revisit explain`: why a loop was or was not closed, stage by stage, from the files of a run."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from slam.errors import DataError
from slam.record import LoopEventRow, LoopRow, StageRow
from slam.storage.metrics import read_metrics
from slam.storage.tables import read_events, read_loops, read_stages
from slam.telling import headline, told

_NEIGHBOURS = 3  # other frames named where the one asked about has nothing to tell


@dataclass(frozen=True)
class _Run:
    """What the files of a run say.

    Attributes:
        folder: of the run.
        frames: how many there are.
        paradigm: of its place recogniser.
        rows: the ledger, by query.
        stages: what each stage measured, by (query, match).
        events: decisions of the online pose graph about all loops.
    """

    folder: Path
    frames: int
    paradigm: str
    rows: tuple[LoopRow, ...]
    stages: dict[tuple[int, int], StageRow]
    events: tuple[LoopEventRow, ...]


def explain(folder: Path, query: int, match: int | None = None) -> str:
    """Tell in plain words what became of the belief about one frame.

    Args:
        folder: of a run.
        query: frame that was asked about.
        match: the earlier frame that it was, or might have been, matched with.

    Raises:
        DataError: no run in the folder, a damaged file, or a frame that is not in the run.
    """
    run = _read(folder)
    _check(run, query, match)
    rows = [row for row in run.rows if row.query == query]
    if not rows:
        return _silent(run, query)
    row = rows[0]
    lines = [] if match in (None, row.match) else [_other(run, row, match)]
    stage = run.stages.get((row.query, row.match), StageRow(row.query, row.match))
    events = [event for event in run.events if (event.query, event.match) == (row.query, row.match)]
    lines.append(headline(row))
    lines += [f"  {name:<15} {words}" for name, words in told(run.paradigm, row, stage, events)]
    return "\n".join(lines)


def _read(folder: Path) -> _Run:
    if not (folder / "loops.csv").is_file():
        raise DataError(
            f"{folder}: expected the folder of a run with a loops.csv, found none; make one with: "
            f"revisit run SOURCE --out {folder}"
        )
    metrics = read_metrics(folder / "metrics.json")
    places, frames = metrics.get("places"), metrics.get("frames")
    if not isinstance(frames, int):
        raise DataError(f"{folder / 'metrics.json'}: expected the number of frames, found {frames!r}; run again")
    paradigm = str(places.get("paradigm", "")) if isinstance(places, dict) else ""
    stages = {(row.query, row.match): row for row in read_stages(folder / "loop_stages.csv")}
    events = read_events(folder / "loop_events.csv")
    return _Run(folder, frames, paradigm, read_loops(folder / "loops.csv"), stages, events)


def _check(run: _Run, query: int, match: int | None) -> None:
    if not 0 <= query < run.frames:
        raise DataError(
            f"{run.folder}: expected a query from 0 to {run.frames - 1}, the frames of this run, got {query}"
        )
    if match is not None and not 0 <= match < query:
        raise DataError(f"{run.folder}: expected a match from 0 to {query - 1}, before the query, got {match}")


def _silent(run: _Run, query: int) -> str:
    said = f"Frame {query}: the recogniser ({run.paradigm}) found no earlier frame to compare it with."
    if not run.rows:
        return f"{said}\nIt found none for any frame of this run: the drive may be too short, or show no place twice."
    nearest = sorted(run.rows, key=lambda row: (abs(row.query - query), row.query))[:_NEIGHBOURS]
    named = ", ".join(f"{row.query} ({_outcome(row)})" for row in sorted(nearest, key=lambda row: row.query))
    return f"{said}\nNearest frames with a match: {named}."


def _other(run: _Run, row: LoopRow, match: int) -> str:
    said = f"The recogniser's best match for frame {row.query} was {row.match}, not {match}; a run keeps only the best."
    with_match = [other.query for other in run.rows if other.match == match]
    if with_match:
        said += f" Frame {match} was the match of {_listed(with_match)}."
    return said + "\n"


def _listed(frames: Sequence[int]) -> str:
    more = f" and {len(frames) - _NEIGHBOURS} more" if len(frames) > _NEIGHBOURS else ""
    return ", ".join(map(str, frames[:_NEIGHBOURS])) + more


def _outcome(row: LoopRow) -> str:
    if row.in_graph:
        return "closed"
    if not row.accepted:
        return "not accepted"
    return "left out of the map" if row.verified else "not proved by geometry"
