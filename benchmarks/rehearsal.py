"""The full rehearsal: a simulated town along the path of KITTI 00 with each of the four paradigms, and the report.

    python benchmarks/rehearsal.py KITTI/poses/00.txt --out DIR [--drive FOLDER]

Renders the drive first (half an hour on two cores; into DIR/drive, or FOLDER, where it is kept), then runs the whole
pipeline with recording and map, one run after the other, by `revisit benchmark`, whose report is DIR/runs/report.html.
"""

import argparse
import csv
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
from command_line import existing, run_script
from rich.console import Console
from rich.table import Table

from slam.simulation import SimulationConfig, simulate

PARADIGMS = ("sequence-histograms", "dynamic-sequences", "hierarchical-places", "tracked-words")
SPEED_M_PER_S = 8.2  # gives as many frames on the path as KITTI has
_TIMES = 500  # frames at the beginning and at the end, whose times are compared


def render(poses: Path, folder: Path) -> None:
    """Render the drive, unless it is there."""
    if not (folder / "poses").is_dir():
        config = SimulationConfig(shape=str(poses.resolve()), speed_m_per_s=SPEED_M_PER_S, difficulty="standard")
        simulate(config, folder)


def run_all(drive: Path, out: Path) -> None:
    """Run the pipeline with each paradigm, in one process."""
    out.mkdir(parents=True, exist_ok=True)
    names = ", ".join(f'"{name}"' for name in PARADIGMS)
    config = out / "rehearsal.toml"
    config.write_text(
        f'paradigms = [{names}]\nrecord = true\n\n[[sources]]\npath = "{drive.resolve()}"\nname = "kitti00"\n'
    )
    command = [sys.executable, "-c", "from slam.cli.app import main; main()", "benchmark", str(config)]
    subprocess.run([*command, "--out", str(out / "runs"), "--workers", "0"], check=True)


def slowdown(run: Path) -> float:
    """Mean time of a frame at the end of a run over that at its beginning; the very first frames left out."""
    with (run / "frames.csv").open() as file:
        rows = list(csv.DictReader(file))
    stages = [name for name in rows[0] if name.endswith("_ms")]
    spent = np.array([sum(float(row[name] or 0) for name in stages) for row in rows])
    return float(np.mean(spent[-_TIMES:]) / np.mean(spent[10 : 10 + _TIMES]))


def main() -> None:
    """Render, run, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("poses", type=existing)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--drive", type=Path, help="where the rendered drive is, or is to be kept")
    arguments = parser.parse_args()
    drive = arguments.drive or arguments.out / "drive"
    render(arguments.poses, drive)
    run_all(drive, arguments.out)
    table = Table(
        "paradigm", "frames/s", "end/begin", "memory MB", "ATE m", "corrected", "kept", "false", "R@P100", "±10"
    )
    for run in sorted((arguments.out / "runs" / "jobs").iterdir()):
        if not (run / "metrics.json").is_file():
            continue
        m = json.loads((run / "metrics.json").read_text())
        places, loops = m["places"], m["loops"]
        table.add_row(
            places["paradigm"], f"{m['frames_per_second']:.1f}", f"{slowdown(run):.2f}", f"{m['peak_memory_mb']:.0f}",
            f"{m['odometry']['ate_m']:.2f}", f"{m['corrected']['ate_m']:.2f}", str(loops["kept"]), str(loops["false"]),
            f"{places['recall_at_100_precision']:.4f}", f"{places['tolerance_10']['recall_at_100_precision']:.4f}",
        )  # fmt: skip
    Console(width=120).print(table)


if __name__ == "__main__":
    run_script(main)
