"""Instrumentation by atheris of the readers, and of the parsers below them that are written in Python."""

from collections.abc import Iterator
from contextlib import contextmanager

# Functions that numba compiles cannot be instrumented.
_MODULES = [
    "slam.benchmark.sweep_config", "slam.config", "slam.datasets", "slam.evaluation.revisit_truth_files",
    "slam.apps.train", "slam.io.landmarks", "slam.simulation.scenario.vehicle_path", "slam.io",
    "place_recognition.evaluation", "place_recognition.vocabulary.vocabulary_file", "rosbags", "tomllib",
    "yaml", "json", "csv",
]  # fmt: skip


@contextmanager
def instrument(guided: bool) -> Iterator[None]:
    """Instrument the modules that are imported in the block, if the fuzzer is guided by coverage."""
    if not guided:
        yield
        return
    import atheris

    with atheris.instrument_imports(include=_MODULES, enable_loader_override=False):
        yield
