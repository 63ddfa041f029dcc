"""Where the memory goes: what each part of the system holds on to when the drive ends."""

from place_recognition.evaluation.map_size import count_array_bytes, map_size
from slam.system import Parts

UNKNOWN = {"memory_mb.pose graph": "it lies in GTSAM, which does not say"}  # note for metrics.json


def held_mb(parts: Parts) -> dict[str, float | None]:
    """Megabytes of the arrays that each stage has gathered, by its name; `map` are the landmarks drawn."""
    held = {
        "odometry": count_array_bytes(parts.eyes.odometry),
        "features": count_array_bytes(parts.features),
        "landmarks": count_array_bytes(parts.loop_closer),
        "place recognition": map_size(parts.recognizer).bytes,
        "map": count_array_bytes(parts.landmarks),
    }
    return {stage: size / 1e6 for stage, size in held.items()} | {"pose graph": None}
