"""`metrics.json`: the measurements of a run; a missing value is null, with a note that gives the reason."""

import json
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from slam.errors import DataError
from slam.io.files import atomic_writer

SCHEMA = 2

# The order of the file; other keys follow in the order given, the notes come last.
_FIRST = ("schema", "source", "sequence", "command", "versions", "seed", "frames", "path_length_m")
_THEN = ("odometry", "online", "corrected", "loops", "places", "graph", "timing_ms")


def write_metrics(path: Path, metrics: Mapping[str, object]) -> None:
    """Write metrics.json: SI units, null for values that could not be computed.

    Args:
        path: the file to write.
        metrics: nested mappings; "notes" maps the dotted name of a null ("odometry.t_rel_percent") to its reason.
            NaN and infinity become null and get a note; NumPy numbers and arrays become plain ones.

    Raises:
        OutputError: the file cannot be written.
    """
    with atomic_writer(path) as file:
        file.write(metrics_text(metrics) + "\n")


def metrics_text(metrics: Mapping[str, object]) -> str:
    """Return the JSON text that `write_metrics` writes."""
    found: dict[str, str] = {}
    plain = {key: _plain(value, key, found) for key, value in metrics.items() if key != "notes"}
    given = metrics.get("notes", {})
    notes = found | (dict(given) if isinstance(given, Mapping) else {})
    order = [key for key in _FIRST + _THEN if key in plain or key == "schema"]
    ordered = {key: plain.get(key, SCHEMA) for key in order} | plain | {"notes": notes}
    return json.dumps(ordered, indent=2, ensure_ascii=False, allow_nan=False)


def read_metrics(path: Path) -> dict[str, object]:
    """Read metrics.json as nested dictionaries.

    Raises:
        DataError: the file is missing, or not a JSON object.
    """
    try:
        metrics = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: expected the metrics of a run, found {error}; run again") from None
    if not isinstance(metrics, dict):
        raise DataError(f"{path}: expected a JSON object, found a {type(metrics).__name__}; run again")
    return metrics


def _plain(value: object, name: str, notes: dict[str, str]) -> object:
    if isinstance(value, Mapping):
        return {str(key): _plain(item, f"{name}.{key}", notes) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(item, f"{name}.{index}", notes) for index, item in enumerate(value)]
    if isinstance(value, float) and not math.isfinite(value):
        notes[name] = f"the computation gave {value}"
        return None
    return str(value) if isinstance(value, Path) else value
