"""`revisit explain`: why a loop was or was not closed, stage by stage, from the files of a run."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from slam.errors import DataError
from slam.io.frames_and_loops_csv import read_events, read_loops, read_stages
from slam.io.metrics import read_metrics
from slam.report.loop_details import describe_outcome, describe_stages
from slam.run_result import LoopEventRow, LoopRow, StageRow

_MAX_NAMED_FRAMES = 3  # other frames that are named if the given one has no match


@dataclass(frozen=True)
class _LoopLog:
    """The loop log of a run, read from its files.

    Attributes:
        folder: folder of the run.
        frames: number of its frames.
        paradigm: paradigm of its place recogniser.
        rows: rows of the loop log, by query.
        stages: measurements of each stage, by (query, match).
        events: decisions of the online pose graph about all loops.
    """

    folder: Path
    frames: int
    paradigm: str
    rows: tuple[LoopRow, ...]
    stages: dict[tuple[int, int], StageRow]
    events: tuple[LoopEventRow, ...]


def explain_loop(folder: Path, query: int, match: int | None = None) -> str:
    """Explain in words, stage by stage, why the match of one frame was or was not closed as a loop.

    Args:
        folder: folder of a run.
        query: frame to explain.
        match: earlier frame that it was, or might have been, matched with.

    Raises:
        DataError: the folder has no run, a file is damaged, or a frame is not in the run.
    """
    run = _read(folder)
    _check(run, query, match)
    rows = [row for row in run.rows if row.query == query]
    if not rows:
        return _explain_no_match(run, query)
    row = rows[0]
    lines = [] if match in (None, row.match) else [_explain_other_match(run, row, match)]
    stage = run.stages.get((row.query, row.match), StageRow(row.query, row.match))
    events = [event for event in run.events if (event.query, event.match) == (row.query, row.match)]
    lines.append(describe_outcome(row))
    lines += [f"  {name:<15} {words}" for name, words in describe_stages(run.paradigm, row, stage, events)]
    return "\n".join(lines)


def _read(folder: Path) -> _LoopLog:
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
    return _LoopLog(folder, frames, paradigm, read_loops(folder / "loops.csv"), stages, events)


def _check(run: _LoopLog, query: int, match: int | None) -> None:
    if not 0 <= query < run.frames:
        raise DataError(
            f"{run.folder}: expected a query from 0 to {run.frames - 1}, the frames of this run, got {query}"
        )
    if match is not None and not 0 <= match < query:
        raise DataError(f"{run.folder}: expected a match from 0 to {query - 1}, before the query, got {match}")


def _explain_no_match(run: _LoopLog, query: int) -> str:
    answer = f"Frame {query}: the recogniser ({run.paradigm}) found no earlier frame that could match it."
    if not run.rows:
        return f"{answer}\nNo frame of this run has a match: the recording may be too short, or visit no place twice."
    nearest = sorted(run.rows, key=lambda row: (abs(row.query - query), row.query))[:_MAX_NAMED_FRAMES]
    named = ", ".join(f"{row.query} ({_outcome(row)})" for row in sorted(nearest, key=lambda row: row.query))
    return f"{answer}\nNearest frames with a match: {named}."


def _explain_other_match(run: _LoopLog, row: LoopRow, match: int) -> str:
    answer = (
        f"The recogniser's best match for frame {row.query} was {row.match}, not {match}; a run keeps only the best."
    )
    with_match = [other.query for other in run.rows if other.match == match]
    if with_match:
        answer += f" Frame {match} was the match of {_listed(with_match)}."
    return answer + "\n"


def _listed(frames: Sequence[int]) -> str:
    more = f" and {len(frames) - _MAX_NAMED_FRAMES} more" if len(frames) > _MAX_NAMED_FRAMES else ""
    return ", ".join(map(str, frames[:_MAX_NAMED_FRAMES])) + more


def _outcome(row: LoopRow) -> str:
    if row.in_graph:
        return "closed"
    if not row.accepted:
        return "not accepted"
    return "left out of the map" if row.verified else "not verified by geometry"
