"""The whole pipeline on one drive: frames per second, time of each stage, and errors before and after loop closing.

python benchmarks/chain.py data/laps
python benchmarks/chain.py ~/kitti/dataset --sequence 05 --no-record
"""

import argparse
import json
import tempfile
from pathlib import Path

from command_line import existing, run_script
from rich.console import Console
from rich.table import Table

from slam.pipeline.pipeline import RunOptions, run_pipeline


def run_once(source: Path, sequence: str | None, record: bool) -> dict[str, dict[str, object]]:
    """Run once into a temporary folder and return the metrics."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        run_pipeline(
            RunOptions(source=source, sequence=sequence, out=out),
            {"save_recording": record},
            Console(stderr=True),
            Console(stderr=True),
        )
        return json.loads((out / "metrics.json").read_text())


def stage_table(metrics: dict[str, dict[str, object]]) -> Table:
    """Make a table of the milliseconds of each stage and its share of the median frame."""
    timing = metrics["timing_ms"]
    total = timing["total"]["median"]
    table = Table("stage", "median ms", "p99 ms", "share of the median", title="Time of each stage")
    for stage, spent in timing.items():
        share = spent["median"] / total
        table.add_row(stage, f"{spent['median']:.1f}", f"{spent['p99']:.1f}", f"{share:.0%}")
    return table


def main() -> None:
    """Run, then print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", type=existing, help="root of a drive in KITTI layout")
    parser.add_argument("--sequence")
    parser.add_argument("--no-record", action="store_true", help="without the recording")
    arguments = parser.parse_args()
    metrics = run_once(arguments.source, arguments.sequence, not arguments.no_record)
    console = Console()
    console.print(stage_table(metrics))
    console.print(f"{metrics['frames']} frames, {metrics['frames_per_second']:.1f} frames per second in all")
    console.print(f"ATE {metrics['odometry']['ate_m']} m by odometry, {metrics['corrected']['ate_m']} m corrected")
    console.print(f"loops: {metrics['loops']}")


if __name__ == "__main__":
    run_script(main)
