"""Provenance of results, for metrics.json: source, command and versions, and the memory that the run used."""

import platform
import resource
import shlex
import sys
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path

from place_recognition.evaluation.memory import count_array_bytes, map_size
from slam.system import Components

# Reasons for values that are unknown, as they stand in metrics.json.
UNKNOWN = {"memory_mb.pose graph": "GTSAM does not report its memory"}
_LIBRARIES = ("revisit-slam", "numpy", "opencv-python-headless", "gtsam", "numba", "rerun-sdk")


def provenance(source: Path, sequence: str, command: Sequence[str] = ()) -> dict[str, object]:
    """Source, sequence, command and versions, as they stand in metrics.json.

    Args:
        source: path of the dataset.
        sequence: name of the sequence.
        command: arguments of an equivalent command; empty for those that were typed.
    """
    versions = {"python": platform.python_version()} | {name: metadata.version(name) for name in _LIBRARIES}
    return {
        "source": str(source),
        "sequence": sequence,
        "command": shlex.join(["revisit", *(command or sys.argv[1:])]),
        "versions": versions,
    }


def memory_mb(components: Components) -> dict[str, float | None]:
    """Megabytes of the arrays that each component holds at the end of a run, by stage; `map` is the landmark map."""
    held = {
        "odometry": components.odometry.array_bytes(),
        "features": count_array_bytes(components.features),
        "landmarks": count_array_bytes(components.loop_closer),
        "place recognition": map_size(components.recognizer).bytes,
        "map": count_array_bytes(components.landmarks),
    }
    return {stage: size / 1e6 for stage, size in held.items()} | {"pose graph": None}


def peak_memory_mb() -> float:
    """Maximum resident memory of this process so far, megabytes."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1024.0**2 if sys.platform == "darwin" else 1024.0)
