"""Fuzzing of all readers of files: no input may crash or hang one, take a gigabyte, or give a useless message.

Run from the root, with as many inputs as there is time for:

    python -m tests.fuzzing --inputs 1000000 --out runs/fuzz

Every reader of `tests/fuzzing/readers.py` gets its share of the inputs, in processes of its own, made in three ways:
valid files that were damaged, files put together by hypothesis, and files that atheris found to reach new lines of the
reader (`pip install 'revisit-slam[fuzz]'`; without it damaged files take its share). A call may take 2 s, and a process
may have 1 GB. What fails is kept in `--out`, one file for each kind of failure, and belongs into
`tests/fuzzing/corpus`.
"""

import argparse
import importlib.util
import json
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.table import Table

from .tally import Tally

ENGINES = {"damaged": 0.5, "generated": 0.05, "guided": 0.45}  # share of the inputs


def main() -> None:
    """Try every reader and print the table; exit with 1 where one failed."""
    options = _options()
    if options.engine:
        _run_engine(options)
        return
    options.out.mkdir(parents=True, exist_ok=True)
    tallies: dict[str, Tally] = {}
    for engine in ENGINES:
        command = [sys.executable, "-m", "tests.fuzzing", "--engine", engine, "--inputs", str(options.inputs), "--seed"]
        subprocess.run([*command, str(options.seed), "--out", str(options.out), *options.readers], check=True)
        found = json.loads((options.out / f"{engine}.json").read_text())
        for name, values in found.items():
            tallies.setdefault(name, Tally()).add(Tally(**values))
    _print(tallies)
    sys.exit(any(tally.failures for tally in tallies.values()))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("readers", nargs="*", help="names in tests/fuzzing/readers.py; all of them without")
    parser.add_argument("--inputs", type=int, default=1_000_000, help="in all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("runs/fuzz"), help="folder for what fails")
    parser.add_argument("--engine", choices=ENGINES, help="make inputs in this way alone, and print no table")
    return parser.parse_args()


def _run_engine(options: argparse.Namespace) -> None:
    """Try every reader on the inputs of one engine; the tallies go to a file."""
    from .instrumentation import instrument

    guided = options.engine == "guided" and importlib.util.find_spec("atheris") is not None
    with instrument(guided):
        from .process import fuzz_apart
        from .readers import READERS

    engine = "damaged" if options.engine == "guided" and not guided else options.engine
    seed = options.seed + 1_000_000 * list(ENGINES).index(options.engine)
    names = options.readers or list(READERS)
    whole = sum(READERS[name].share for name in names) / ENGINES[options.engine]
    tallies = {}
    for name in names:
        inputs = round(options.inputs * READERS[name].share / whole)
        tallies[name] = fuzz_apart(name, engine, inputs, seed, options.out)
        line = f"{engine}, {name}: {tallies[name].inputs:,} inputs, failures {tallies[name].failures or 'none'}"
        print(line, file=sys.stderr, flush=True)
        texts = {key: asdict(tally) for key, tally in tallies.items()}
        (options.out / f"{options.engine}.json").write_text(json.dumps(texts, indent=1))


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
    Console(width=120).print(table)


def _cells(tally: Tally) -> list[str]:
    counts = [f"{number:,}" for number in (tally.inputs, tally.accepted, tally.refused)]
    return [*counts, f"{tally.slowest_ms:.0f}", f"{tally.peak_mb:.0f}", str(tally.failed), str(len(tally.failures))]


if __name__ == "__main__":
    main()
