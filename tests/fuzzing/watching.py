"""What atheris watches: the readers, and the parsers beneath them that are written in Python."""

from collections.abc import Iterator
from contextlib import contextmanager

# Not what numba compiles.
_WATCHED = [
    "slam.benchmark.sweep_config", "slam.config", "slam.datasets", "slam.evaluation.ground_truth",
    "slam.apps.train", "slam.io.ply", "slam.simulation.scenario.trajectory", "slam.io",
    "place_recognition.evaluation", "place_recognition.vocabulary.vocabulary_file", "pykitti", "rosbags", "tomllib",
    "yaml", "json", "csv",
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
