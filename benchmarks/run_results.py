"""Results of a run that must be the same whenever, wherever and however often it was interrupted."""

import json
from pathlib import Path

# Files and metrics that hold times differ from run to run; all others are compared.
_TIMED = {"frames.csv", "report.html", "run.log", "recording.rrd", "map.db", "metrics.json"}
_TIMES = {"command", "timing_ms", "frames_per_second", "wall_seconds", "peak_memory_mb", "memory_mb"}


def lasting_results(folder: Path) -> dict[str, object]:
    """Return the content of the files of a run, and its metrics, by name, without those that hold times."""
    metrics = json.loads((folder / "metrics.json").read_text())
    metrics["graph"].pop("seconds")
    kept = {f"metrics.json: {name}": value for name, value in metrics.items() if name not in _TIMES}
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name not in _TIMED} | kept


def differing(expected: dict[str, object], found: dict[str, object]) -> list[str]:
    """Return the names of results that differ, or are missing in one of the two."""
    return sorted(name for name in expected.keys() | found.keys() if expected.get(name) != found.get(name))
