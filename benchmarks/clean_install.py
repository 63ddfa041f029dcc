"""Installation into a clean environment of each Python, and equality of the demo's results there.

Run from the root: `python benchmarks/clean_install.py python3.11 python3.12 python3.13 --out DIR [--install WHAT]`.
For each interpreter it makes a virtual environment in DIR, installs WHAT into it (a wheel, an sdist, or by default this
checkout, each with extras if named, `'.[ros]'`), and renders and runs the demo there with a cache of its own. Equal
digests mean that the interpreters have rendered the same images and estimated the same trajectory to the last bit. An
interpreter in another place, such as a container, is checked there, and its row is compared by the digests.
"""

import argparse
import json
import os
import subprocess
import time
from hashlib import sha256
from pathlib import Path
from typing import Any

from command_line import run_script
from rich.console import Console
from rich.table import Table

ROOT = Path(__file__).parents[1]
RESULTS = (
    "trajectory_odometry.txt",
    "trajectory_online.txt",
    "trajectory_corrected.txt",
    "loops.csv",
    "pose_graph_after.g2o",
)
HELP_RUNS = 5


def run(command: list[str | Path], folder: Path) -> float:
    """Run a command in a folder, where nothing of this checkout can be imported, and return its seconds."""
    clean = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    start = time.perf_counter()
    subprocess.run(command, cwd=folder, env=clean | {"XDG_CACHE_HOME": str(folder / "cache")}, check=True)
    return time.perf_counter() - start


def digest(files: list[Path]) -> str:
    """Return the first digits of the SHA-256 of all the bytes of some files, one after the other."""
    total = sha256()
    for path in files:
        total.update(path.read_bytes())
    return total.hexdigest()[:12]


def install_and_drive(interpreter: str, what: str, folder: Path) -> list[str]:
    """Install into a new environment in a folder and run the demo there. Returns the row of the table."""
    folder.mkdir(parents=True)
    environment = folder / "venv"
    run([interpreter, "-m", "venv", environment], folder)
    installed = run([environment / "bin/pip", "install", "--quiet", what], folder)
    run([environment / "bin/pip", "check"], folder)
    revisit = environment / "bin/revisit"
    run([revisit, "doctor"], folder)
    run([revisit, "demo", "--out", folder / "demo"], folder)
    helped = min(run([revisit, "--help"], folder) for _ in range(HELP_RUNS))
    metrics = json.loads((folder / "demo/metrics.json").read_text())
    images = digest(sorted((folder / "cache").rglob("*.png")))
    return [
        *_figures(metrics),
        f"{installed:.0f}",
        f"{helped:.2f}",
        images,
        digest([folder / "demo" / name for name in RESULTS]),
    ]


def _figures(metrics: dict[str, Any]) -> list[str]:
    loops = metrics["loops"]
    return [
        metrics["versions"]["python"],
        f"{metrics['frames_per_second']:.1f}",
        f"{metrics['odometry']['ate_m']:.3f}, {metrics['corrected']['ate_m']:.3f}",
        f"{loops['kept']}, {loops['false']}",
    ]


def main() -> None:
    """Check each interpreter and print a row for it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("interpreters", nargs="+")
    parser.add_argument("--out", type=Path, required=True, help="a folder that does not exist yet")
    parser.add_argument("--install", default=str(ROOT), help="what pip installs")
    arguments = parser.parse_args()
    titles = ("python", "frames/s", "ATE odometry, corrected [m]", "loops kept, false", "install [s]", "--help [s]")
    table = Table(*titles, "images", "results")
    try:
        for number, interpreter in enumerate(arguments.interpreters):
            table.add_row(*install_and_drive(interpreter, arguments.install, arguments.out.resolve() / str(number)))
    finally:  # also if a later interpreter fails
        Console(width=160).print(table)


if __name__ == "__main__":
    run_script(main)
