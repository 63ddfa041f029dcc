"""Whether any file can make a reader crash, hang, use a gigabyte, or refuse with words that help nobody.

Run from the root, for all that a machine has time for:

    PYTHONPATH=. python benchmarks/fuzz_readers.py --inputs 1000000 --out runs/fuzz

Every reader of `tests/fuzzing/readers.py` gets its share of the inputs in processes of its own, made in three ways: valid
files that were damaged, files put together by hypothesis, and files that atheris found to reach new lines of the reader
(`pip install 'revisit-slam[fuzz]'`; without it the first way takes its share). A call may take 2 s; a process may have
1 GB. What fails is kept in `--out`, one file for each kind of failure, and belongs into `tests/fuzzing/corpus`.
"""

import argparse
import importlib.util
import json
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path

from rich.console import Console
from rich.table import Table

ENGINES = {"damaged": 0.5, "generated": 0.05, "guided": 0.45}  # share of the inputs
LONGEST_S = 2.0
KILLED_AFTER_S = 30


@dataclass
class Tally:
    """What came of the inputs of one process.

    Attributes:
        inputs: tried.
        accepted: of these; the others were refused, or failed.
        slowest_ms: of all calls.
        peak_mb: memory of the process.
        failures: of each kind, the first file and how many there were.
    """

    inputs: int = 0
    accepted: int = 0
    slowest_ms: float = 0.0
    peak_mb: float = 0.0
    failures: dict[str, list[object]] = field(default_factory=dict)

    def add(self, other: "Tally") -> None:
        """Take in what another process found."""
        self.inputs += other.inputs
        self.accepted += other.accepted
        self.slowest_ms = max(self.slowest_ms, other.slowest_ms)
        self.peak_mb = max(self.peak_mb, other.peak_mb)
        for kind, (file, count) in other.failures.items():
            known = self.failures.setdefault(kind, [file, 0])
            known[1] += count  # type: ignore[operator]

    @property
    def failed(self) -> int:
        """Inputs that failed."""
        return sum(count for _, count in self.failures.values())  # type: ignore[misc]


def main() -> None:
    """Try every reader and print the table; exit with 1 where one failed."""
    options = _options()
    if options.engine:
        from tests.fuzzing.process import fuzz

        fuzz(options.readers[0], options.engine, options.inputs, options.seed, options.out)
        return
    from tests.fuzzing.readers import READERS

    names = options.readers or list(READERS)
    whole = sum(READERS[name].share for name in names)
    options.out.mkdir(parents=True, exist_ok=True)
    tallies = {}
    for name in names:
        tallies[name] = _fuzzed(name, round(options.inputs * READERS[name].share / whole), options)
        one = tallies[name]
        print(f"{name}: {one.inputs:,} inputs, {one.failed} failed {list(one.failures)}", file=sys.stderr, flush=True)
        (options.out / "tallies.json").write_text(json.dumps({k: asdict(v) for k, v in tallies.items()}, indent=1))
    _print(tallies)
    sys.exit(any(tally.failures for tally in tallies.values()))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("readers", nargs="*", help="names in tests/fuzzing/readers.py; all of them without")
    parser.add_argument("--inputs", type=int, default=1_000_000, help="in all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("runs/fuzz"), help="folder for what fails")
    parser.add_argument("--engine", choices=ENGINES, help="for the processes that this starts")
    return parser.parse_args()


def _fuzzed(name: str, inputs: int, options: argparse.Namespace) -> Tally:
    tally = Tally()
    for engine, share in ENGINES.items():
        if engine == "guided" and importlib.util.find_spec("atheris") is None:
            engine = "damaged"
        left, seed = round(inputs * share), options.seed
        while left > 0:
            found = _in_a_process(name, engine, left, seed, options.out)
            tally.add(found)
            left, seed = left - max(found.inputs, 1), seed + 1000  # a process that died is followed by another one
            if seed > options.seed + 20_000:
                break
    return tally


def _in_a_process(name: str, engine: str, inputs: int, seed: int, out: Path) -> Tally:
    """Fuzz in a process; where that dies, the file that killed it is a failure too."""
    with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as work:
        command = [sys.executable, __file__, name, "--engine", engine, "--inputs", str(inputs), "--seed", str(seed)]
        with (Path(work) / "said").open("w") as said:
            done = subprocess.run([*command, "--out", work], stdout=said, stderr=said, check=False)
        tally_file = Path(work) / "tally.json"
        tally = Tally(**json.loads(tally_file.read_text())) if tally_file.exists() else Tally()
        last = (Path(work) / "said").read_text(errors="replace").strip().splitlines()[-1:] or [""]
        if not (Path(work) / "done").exists():
            reason = "hung" if done.returncode == -signal.SIGALRM else f"died ({done.returncode}): {last[0][:200]}"
            tally.failures[f"{engine} {reason}"] = ["killer", 1]
        return _with_files_kept(tally, name, engine, Path(work), out)


def _with_files_kept(tally: Tally, name: str, engine: str, work: Path, out: Path) -> Tally:
    for kind, (file, _) in list(tally.failures.items()):
        source = work / "failures" / str(file)
        if file == "killer":
            from tests.fuzzing.readers import READERS

            source = work / "root" / READERS[name].file
        kept = out / f"{name.replace(' ', '-').replace(',', '')}-{engine}-{time.time_ns()}"
        if source.exists():
            kept.write_bytes(source.read_bytes())
        tally.failures[kind][0] = kept.name
    return tally


def _print(tallies: dict[str, Tally]) -> None:
    table = Table("reader", title="Fuzzing of the readers")
    for column in ("inputs", "accepted", "refused", "slowest ms", "peak MB", "failed", "kinds"):
        table.add_column(column, justify="right")
    whole = Tally()
    for name, tally in tallies.items():
        whole.add(tally)
        table.add_row(name, *_cells(tally))
    table.add_section()
    table.add_row("all", *_cells(whole))
    Console(width=140).print(table)


def _cells(tally: Tally) -> list[str]:
    refused = tally.inputs - tally.accepted - tally.failed
    counts = [f"{number:,}" for number in (tally.inputs, tally.accepted, refused)]
    return [*counts, f"{tally.slowest_ms:.0f}", f"{tally.peak_mb:.0f}", str(tally.failed), str(len(tally.failures))]


if __name__ == "__main__":
    main()
