"""Trials of inputs on a reader in a process of its own, which may die."""

import json
import os
import resource
import signal
import sys
import tempfile
import time
import traceback
import warnings
from dataclasses import asdict
from pathlib import Path

from .acceptance import is_accepted, prepare
from .engines import ENGINES
from .readers import READERS
from .tally import Tally

_MEMORY = 1 << 30
_MAX_CALL_S, _KILLED_AFTER_S = 2.0, 30.0
_REPORT_INTERVAL = 200
_PROJECT = ("/slam/", "/place_recognition/", "/odometry/", "/fuzzing/")
_MAX_DEATHS = 20


def fuzz_apart(name: str, engine: str, inputs: int, start: int, out: Path) -> Tally:
    """Try a number of inputs on a reader, and keep those that fail in the folder `out`.

    A process that dies is followed by another one, with another seed.

    Args:
        name: name of the reader in READERS.
        engine: name of the engine in ENGINES.
        inputs: number of inputs.
        start: seed of the inputs.
        out: folder for the inputs that fail.
    """
    tally = Tally()
    for death in range(_MAX_DEATHS):
        if tally.inputs >= inputs:
            break
        with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as work:
            found = _in_a_process(name, engine, inputs - tally.inputs, start + 1000 * death, Path(work))
            _keep(found, Path(work), out / f"{name.replace(' ', '-').replace(',', '')}-{engine}-{death}")
        tally.add(found)
    return tally


def _in_a_process(name: str, engine: str, inputs: int, start: int, work: Path) -> Tally:
    child = os.fork()
    if child == 0:
        try:
            _fuzz(name, engine, inputs, start, work)
        finally:
            os._exit(1)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    report = work / "tally.json"
    tally = Tally(**json.loads(report.read_text())) if report.exists() else Tally()
    if tally.inputs < inputs:
        output = ((work / "output").read_text(errors="replace").strip().splitlines() or [""])[-1]
        reason = "hung" if status == -signal.SIGALRM else f"died ({status}): {output[:200]}"
        last = work / "root" / READERS[name].file
        (work / "failures" / "killer").write_bytes(last.read_bytes() if last.exists() else b"")
        tally.fail(reason, "killer")
        tally.inputs += 1
    return tally


def _keep(tally: Tally, work: Path, out: Path) -> None:
    for kind, (file, count) in tally.failures.items():
        kept = out.with_name(f"{out.name}-{file}")
        kept.write_bytes((work / "failures" / file).read_bytes())
        tally.failures[kind] = (kept.name, count)


def _fuzz(name: str, engine: str, inputs: int, start: int, work: Path) -> None:
    os.chdir(work)
    output = os.open("output", os.O_WRONLY | os.O_CREAT)
    os.dup2(output, sys.stdout.fileno())
    os.dup2(output, sys.stderr.fileno())
    warnings.simplefilter("ignore")
    trial = _Trial(name, work)
    for data in trial.reader.seeds():  # loads what is loaded late
        trial.attempt(data)
    trial.tally = Tally()
    _limit_memory()
    signal.signal(signal.SIGALRM, signal.SIG_DFL)  # kills, whatever the process is stuck in
    ENGINES[engine](trial, inputs, start)
    trial.finish()


def _limit_memory() -> None:
    """Let the process grow to a gigabyte of memory, and no more."""
    used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    mapped = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    limit = mapped + max(_MEMORY - used, _MEMORY // 4)
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


class _Trial:
    """Tries inputs and keeps count in `tally.json`; inputs that fail are written to `failures/`."""

    def __init__(self, name: str, work: Path) -> None:
        self.reader, self.work, self.root = READERS[name], work, work / "root"
        self.tally = Tally()
        (work / "failures").mkdir()
        prepare(self.reader, self.root)

    def __call__(self, data: bytes) -> None:
        """Try an input."""
        self.attempt(data)
        if self.tally.inputs % _REPORT_INTERVAL == 0:
            self.write_tally()

    def attempt(self, data: bytes) -> None:
        self.tally.inputs += 1
        start = time.perf_counter()
        try:
            self.tally.accepted += self._try(data)
        except Exception as error:
            self._fail(_kind(error), data)
            return
        took = time.perf_counter() - start
        if took > _MAX_CALL_S:  # it may have waited for a busy machine: its processor time and that of its children
            took = min(took, *(self._seconds(data) for _ in range(3)))
        self.tally.slowest_ms = max(self.tally.slowest_ms, 1000 * took)
        if took > _MAX_CALL_S:
            self._fail(f"took more than {_MAX_CALL_S:g} s", data)

    def _try(self, data: bytes) -> bool:
        signal.setitimer(signal.ITIMER_REAL, _KILLED_AFTER_S)
        try:
            return is_accepted(self.reader, self.root, data)
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)

    def _seconds(self, data: bytes) -> float:
        """Processor time of a trial, with that of its child processes."""
        start = sum(os.times()[:4])
        self._try(data)
        return sum(os.times()[:4]) - start

    def _fail(self, kind: str, data: bytes) -> None:
        file = str(len(self.tally.failures))
        if kind not in self.tally.failures:
            (self.work / "failures" / file).write_bytes(data)
        self.tally.fail(kind, file)

    def write_tally(self) -> None:
        self.tally.peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        (self.work / "tally.json").write_text(json.dumps(asdict(self.tally)))

    def finish(self) -> None:
        """Write the tally and end the process."""
        self.write_tally()
        os._exit(0)


def _kind(error: BaseException) -> str:
    """Describe an error and its place; inputs that fail alike have the same description."""
    frames = [f for f in traceback.extract_tb(error.__traceback__) if any(part in f.filename for part in _PROJECT)]
    where = f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "elsewhere"
    text = " ".join(str(error).split())
    text = text.split(":")[0] if isinstance(error, AssertionError) else text
    return f"{type(error).__name__} at {where}: {text[:60]}"
