"""What atheris watches: the readers, and the parsers beneath them that are written in Python."""

from collections.abc import Iterator
from contextlib import contextmanager

# Not what numba compiles.
_WATCHED = [
    "slam.benchmark.sweep", "slam.config", "slam.datasets", "slam.evaluation.truth", "slam.filter_training",
    "slam.mapping.ply", "slam.simulation.routes", "slam.storage", "place_recognition.evaluation",
    "place_recognition.map.vocabulary_file", "pykitti", "rosbags", "tomllib", "yaml", "json", "csv",
]  # fmt: skip


@contextmanager
def watched(guided: bool) -> Iterator[None]:
    """Have atheris watch the modules that are imported in the block."""
    if not guided:
        yield
        return
    import atheris

    with atheris.instrument_imports(include=_WATCHED, enable_loader_override=False):
        yield
