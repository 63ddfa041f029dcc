"""What of a run's results must not depend on when, where and how often it was begun."""

import json
from pathlib import Path

# What holds times differs from run to run; of the metrics the rest is compared.
_TIMED = {"frames.csv", "report.html", "run.log", "recording.rrd", "map.db", "metrics.json"}
_TIMES = {"command", "timing_ms", "frames_per_second", "wall_seconds", "peak_memory_mb", "memory_mb"}


def lasting_results(folder: Path) -> dict[str, object]:
    """Content of the files in a run's folder, and the metrics, by name; nothing that holds times."""
    metrics = json.loads((folder / "metrics.json").read_text())
    metrics["graph"].pop("seconds")
    kept = {f"metrics.json: {name}": value for name, value in metrics.items() if name not in _TIMES}
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name not in _TIMED} | kept


def differing(expected: dict[str, object], found: dict[str, object]) -> list[str]:
    """Names of what is not the same in both, or is missing in one."""
    return sorted(name for name in expected.keys() | found.keys() if expected.get(name) != found.get(name))
