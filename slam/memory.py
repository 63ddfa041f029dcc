"""Memory of the system: what each component holds when the run ends."""

from place_recognition.evaluation.map_size import count_array_bytes, map_size
from slam.system import Components

UNKNOWN = {"memory_mb.pose graph": "it lies in GTSAM, which does not say"}  # note for metrics.json


def held_mb(components: Components) -> dict[str, float | None]:
    """Megabytes of the arrays that each component holds, by stage; `map` is the landmark map."""
    held = {
        "odometry": components.odometry.array_bytes(),
        "features": count_array_bytes(components.features),
        "landmarks": count_array_bytes(components.loop_closer),
        "place recognition": map_size(components.recognizer).bytes,
        "map": count_array_bytes(components.landmarks),
    }
    return {stage: size / 1e6 for stage, size in held.items()} | {"pose graph": None}
