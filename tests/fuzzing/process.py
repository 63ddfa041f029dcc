"""One process that tries inputs on one reader; `benchmarks/fuzz_readers.py` starts it and reads what it leaves."""

import json
import random
import resource
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from hypothesis import HealthCheck, Phase, given, seed, settings

_MEMORY = 1 << 30
_LONGEST_S, _KILLED_AFTER_S = 2.0, 30.0
_TOLD_EVERY = 500
_PROJECT = ("/slam/", "/place_recognition/", "/odometry/", "/fuzzing/")
# What atheris watches: the readers, and the parsers beneath them that are written in Python. Not what numba compiles.
_WATCHED = [
    "slam.benchmark.sweep", "slam.config", "slam.datasets", "slam.evaluation.truth", "slam.filter_training",
    "slam.mapping.ply", "slam.simulation.routes", "slam.storage", "place_recognition.evaluation.ground_truth",
    "place_recognition.map.vocabulary_file", "pykitti", "rosbags", "scipy.io", "tomllib", "yaml", "json", "csv",
]  # fmt: skip


class Trial:
    """Tries inputs and keeps count in `tally.json`; what fails is written to `failures/`."""

    def __init__(self, name: str, work: Path) -> None:
        from .readers import READERS, prepare

        self.reader, self.work, self.root = READERS[name], work, work / "root"
        self.inputs = self.accepted = 0
        self.slowest = 0.0
        self.failures: dict[str, list[object]] = {}
        (work / "failures").mkdir()
        prepare(self.reader, self.root)

    def __call__(self, data: bytes) -> None:
        """Try one input."""
        from .readers import outcome

        signal.setitimer(signal.ITIMER_REAL, _KILLED_AFTER_S)
        start = time.perf_counter()
        try:
            self.accepted += outcome(self.reader, self.root, data)
        except BaseException as error:
            self._fail(_kind(error), data)
        took = time.perf_counter() - start
        signal.setitimer(signal.ITIMER_REAL, 0)
        self.inputs += 1
        self.slowest = max(self.slowest, took)
        if took > _LONGEST_S:
            self._fail(f"took more than {_LONGEST_S:g} s", data)
        if self.inputs % _TOLD_EVERY == 0:
            self.tell()

    def _fail(self, kind: str, data: bytes) -> None:
        if kind not in self.failures:
            file = f"{len(self.failures)}"
            (self.work / "failures" / file).write_bytes(data)
            self.failures[kind] = [file, 0]
        self.failures[kind][1] += 1  # type: ignore[operator]
        self.tell()

    def tell(self) -> None:
        """Write the tally."""
        tally = {
            "inputs": self.inputs,
            "accepted": self.accepted,
            "slowest_ms": 1000 * self.slowest,
            "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
            "failures": self.failures,
        }
        (self.work / "tally.json").write_text(json.dumps(tally))


def _kind(error: BaseException) -> str:
    """What went wrong, and where: the same for all inputs that fail alike."""
    frames = [f for f in traceback.extract_tb(error.__traceback__) if any(part in f.filename for part in _PROJECT)]
    where = f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "elsewhere"
    said = str(error)
    said = said.split(":")[0] if isinstance(error, AssertionError) else said
    return f"{type(error).__name__} at {where}: {said[:100]}"


def fuzz(name: str, engine: str, inputs: int, start: int, work: Path) -> None:
    """Try so many inputs on a reader, made by an engine, from a seed on; results go to the folder `work`."""
    with _watched(engine == "guided"):
        from . import readers  # noqa: F401 - loaded while atheris watches

    trial = Trial(name, work)
    warnings.simplefilter("ignore")
    for data in trial.reader.seeds():  # loads what is loaded late
        trial(data)
    _limit_memory()
    signal.signal(signal.SIGALRM, signal.SIG_DFL)  # kills, whatever the process is stuck in
    ENGINES[engine](trial, inputs, start)
    _finish(trial)


def _finish(trial: Trial) -> None:
    trial.tell()
    (trial.work / "done").touch()


def _limit_memory() -> None:
    """Let the process grow to a gigabyte of memory, and no more."""
    used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    mapped = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    limit = mapped + max(_MEMORY - used, _MEMORY // 4)
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


@contextmanager
def _watched(guided: bool) -> Iterator[None]:
    if not guided:
        yield
        return
    import atheris

    with atheris.instrument_imports(include=_WATCHED, enable_loader_override=False):
        yield


def _damaged(trial: Trial, inputs: int, start: int) -> None:
    from .mutations import mutated

    rng, seeds = random.Random(start), trial.reader.seeds()
    for _ in range(inputs):
        trial(mutated(rng, seeds))


def _generated(trial: Trial, inputs: int, start: int) -> None:
    for part in range(-(-inputs // 2000)):  # hypothesis repeats itself in long runs
        _some_generated(trial, min(2000, inputs - 2000 * part), start + part)


def _some_generated(trial: Trial, inputs: int, start: int) -> None:
    @seed(start)
    @settings(
        max_examples=inputs, database=None, deadline=None, phases=[Phase.generate], suppress_health_check=list(HealthCheck)
    )
    @given(trial.reader.generated)
    def run(data: bytes) -> None:
        trial(data)

    run()


def _guided(trial: Trial, inputs: int, start: int) -> None:
    import atheris

    from .mutations import MOST_BYTES, mutated

    corpus = trial.work / "corpus"
    corpus.mkdir()
    for index, data in enumerate(trial.reader.seeds()):
        (corpus / str(index)).write_bytes(data)
    last = trial.inputs + inputs

    def one(data: bytes) -> None:
        trial(data)
        if trial.inputs >= last:
            _finish(trial)
            sys.stdout.flush()
            import os

            os._exit(0)  # libFuzzer would go on

    def changed(data: bytes, most: int, number: int) -> bytes:
        rng = random.Random(number)
        return mutated(rng, [data])[:most] if rng.random() < 0.5 else atheris.Mutate(data, most)

    limits = [f"-max_len={MOST_BYTES}", f"-seed={start + 1}", "-rss_limit_mb=4096", "-timeout=60", "-verbosity=0"]
    atheris.Setup(["fuzz", f"-runs={inputs * 2 + 1000}", *limits, str(corpus)], one, custom_mutator=changed)
    atheris.Fuzz()


ENGINES: dict[str, Callable[[Trial, int, int], None]] = {
    "damaged": _damaged,
    "generated": _generated,
    "guided": _guided,
}
