"""`revisit explain`: why a loop was or was not closed, stage by stage, from the files of a run."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from slam.errors import DataError
from slam.ledger import ONLINE_SEPARATOR
from slam.record import LoopRow, StageRow
from slam.storage.metrics import read_metrics
from slam.storage.tables import read_loops, read_stages

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
    """

    folder: Path
    frames: int
    paradigm: str
    rows: tuple[LoopRow, ...]
    stages: dict[tuple[int, int], StageRow]


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
    return "\n".join([*lines, *_told(run, row)])


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
    return _Run(folder, frames, paradigm, read_loops(folder / "loops.csv"), stages)


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


def _told(run: _Run, row: LoopRow) -> Iterator[str]:
    stage = run.stages.get((row.query, row.match), StageRow(row.query, row.match))
    verdict = "closed" if row.in_graph else "not closed"
    yield f"Frame {row.query} with frame {row.match}: {verdict}."
    why = row.reason.removeprefix("not accepted: ")
    accepted = "taken for a revisit" if row.accepted else f"not taken for a revisit: {why}"
    yield _line("recogniser", f"{run.paradigm}: score {row.score:.3g}, {accepted}")
    yield _line("epipolar proof", _epipolar(stage))
    yield _line("relative pose", _relative_pose(row, stage))
    yield _line("drift gate", _gate(stage))
    for number, change in enumerate(stage.online.split(ONLINE_SEPARATOR) if stage.online else ["was not asked"]):
        yield _line("" if number else "while driving", change)
    yield _line("final map", _back_end(row))
    if row.truth is not None:
        wrong = "not a revisit, or its relative pose is wrong" if row.verified else "not a revisit"
        yield _line("ground truth", "a true revisit" if row.truth else wrong)


def _line(stage: str, said: str) -> str:
    return f"  {stage:<15} {said}"


def _epipolar(stage: StageRow) -> str:
    if stage.epipolar_inliers is None:
        return "none was sought" if stage.epipolar_verified else "failed"
    proved = "enough" if stage.epipolar_verified else "too few"
    return f"{stage.epipolar_inliers} matches agree with one epipolar geometry, {proved}"


def _relative_pose(row: LoopRow, stage: StageRow) -> str:
    if row.verified:
        return (
            f"{row.inliers} of {row.matches} landmark matches agree; the camera had moved {_axes(stage)} m and turned "
            f"{stage.turn_deg:.2f} deg (one sigma {stage.sigma_m:.3f} m, {stage.sigma_deg:.3f} deg)"
        )
    if not row.accepted:
        return "was not sought: the recogniser did not accept the match"
    return f"none: {row.reason} ({row.inliers} of {row.matches} landmark matches agree)"


def _axes(stage: StageRow) -> str:
    named = (("right", "left", stage.x), ("down", "up", stage.y), ("forward", "back", stage.z))
    return ", ".join(f"{abs(value):.2f} {there if value >= 0 else back}" for there, back, value in named)


def _gate(stage: StageRow) -> str:
    if stage.gate_passed is None:
        return "was not asked"
    return f"{'passed' if stage.gate_passed else 'refused'}: {stage.gate_reason}"


def _back_end(row: LoopRow) -> str:
    if math.isnan(row.weight):
        return "was not asked"
    return f"{row.reason} (weight {row.weight:.2f}, residual {row.residual:.2f} sigma)"
