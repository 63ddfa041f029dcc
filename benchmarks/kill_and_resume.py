"""Kill a run at random moments, resume it, and compare every result with that of an undisturbed run.

python benchmarks/kill_and_resume.py data/laps --kills 20
"""

import argparse
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from command_line import existing, run_script
from rich.console import Console
from rich.table import Table
from run_results import differing, lasting_results

from slam.map_database.resume import find_resumable_run


def command(arguments: argparse.Namespace, out: Path, *more: str) -> list[str]:
    """Return the command that runs the pipeline in a process of its own."""
    run = [
        sys.executable,
        "-c",
        "from slam.cli.app import main; main()",
        "run",
        str(arguments.source),
        "--out",
        str(out),
    ]
    return [*run, "--paradigm", arguments.paradigm, "--no-record", *more]


def kill_once(arguments: argparse.Namespace, out: Path, seconds: float) -> tuple[int, float]:
    """Kill a run after some seconds and resume it; return the frames kept and the seconds of the second run."""
    process = subprocess.Popen(command(arguments, out), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    time.sleep(seconds)
    process.kill()
    process.wait()
    stopped = find_resumable_run(out)
    begin = time.perf_counter()
    subprocess.run(command(arguments, out, "--resume"), check=True, capture_output=True)
    return (stopped.frames if stopped else 0), time.perf_counter() - begin


def main() -> None:
    """Run, kill, resume, compare, and print a line for each kill."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", type=existing)
    parser.add_argument("--paradigm", default="tracked-words")
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    console, moments = Console(), random.Random(arguments.seed)
    table = Table("killed after s", "frames kept", "s to the end", "differs in", title=f"{arguments.paradigm}")
    with tempfile.TemporaryDirectory() as folder:
        begin = time.perf_counter()
        subprocess.run(command(arguments, Path(folder) / "undisturbed"), check=True, capture_output=True)
        whole = time.perf_counter() - begin
        expected = lasting_results(Path(folder) / "undisturbed")
        for number in range(arguments.kills):
            out, seconds = Path(folder) / f"killed-{number}", moments.uniform(0, whole)
            frames, rest = kill_once(arguments, out, seconds)
            differs = differing(expected, lasting_results(out))
            table.add_row(f"{seconds:.1f}", str(frames), f"{rest:.1f}", ", ".join(differs) or "nothing")
    console.print(table)
    console.print(f"undisturbed: {whole:.1f} s")


if __name__ == "__main__":
    run_script(main)
