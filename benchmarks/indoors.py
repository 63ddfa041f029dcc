"""Rooms and other recordings in TUM RGB-D's layout: this checkout beside ORB-SLAM3, with one camera and with depth.

    python benchmarks/indoors.py FOLDER... [--sensor mono depth] [--orb-slam3 PYTHON --vocabulary FILE] [--work DIR]

FOLDER is a recording with ground truth, such as `revisit simulate room --sensor depth` writes. PYTHON is the
interpreter of an environment with `pyorbslam3`, numpy and opencv-python-headless (GPL: never in ours); FILE is made by
`orb_vocabulary.py`. For each program: frames tracked, ATE after alignment (Sim(3) with one camera) of the odometry and
of the final result, also in per cent of the path, loops kept and false, and milliseconds a frame. ORB-SLAM3's first ATE
is that of the frames as they were tracked, its second that of the key frames of the final map.
"""

import argparse
import csv
import subprocess
from pathlib import Path

import numpy as np
from command_line import existing, run_script
from rich.console import Console

from slam.evaluation.trajectory_errors import Alignment, path_length, trajectory_errors
from slam.io.metrics import read_metrics
from slam.io.trajectory_reader import read_trajectory
from slam.pipeline.pipeline import RunOptions, run_pipeline
from slam.report.formatting import metric_value

HERE = Path(__file__).parent
HEADINGS = ("recording", "sensor", "program", "tracked", "ATE m", "%", "final ATE m", "%", "loops", "false", "ms")


def revisit(folder: Path, sensor: str, out: Path) -> list[str]:
    """Run this checkout and return the cells after the program's name."""
    quiet = Console(quiet=True)
    settings = {"mono": sensor == "mono", "save_recording": False, "save_map": False}
    run_pipeline(RunOptions(source=folder, out=out, overwrite=True), settings, quiet, quiet)
    metrics = read_metrics(out / "metrics.json")
    with (out / "frames.csv").open() as file:
        measured = [row["status"] == "measured" for row in csv.DictReader(file)]
    path_length_m, loops = metrics["path_length_m"], metrics["loops"]
    errors = [metric_value(metrics, f"{name}.ate_m") for name in ("odometry", "corrected")]
    spent = 1e3 / metrics["frames_per_second"]
    return [_share(measured), *_errors(errors, path_length_m), str(loops["kept"]), str(loops["false"]), f"{spent:.0f}"]


def orb_slam3(folder: Path, sensor: str, out: Path, python: Path, vocabulary: Path) -> list[str]:
    """Run ORB-SLAM3 and return the cells after the program's name."""
    out.mkdir(parents=True, exist_ok=True)
    script = [str(python), str(HERE / "orb_slam3_indoors.py"), str(folder), str(out)]
    with (out / "log.txt").open("w") as log:
        subprocess.run(
            [*script, "--sensor", sensor, "--vocabulary", str(vocabulary)], stdout=log, stderr=log, check=True
        )
    truth = read_trajectory(folder / "groundtruth.txt")
    alignment: Alignment = "sim3" if sensor == "mono" else "se3"
    errors = []
    for name in ("tracked.tum", "key_frames.tum"):
        found = read_trajectory(out / name)
        nearest = np.abs(truth.times[:, None] - found.times[None]).argmin(axis=0)
        errors.append(trajectory_errors(found.poses, truth.poses[nearest], alignment).ate_m)
    spent = np.loadtxt(out / "milliseconds.txt")
    tracked = len(read_trajectory(out / "tracked.tum").poses)
    return [
        f"{100 * tracked / len(spent):.1f} %",
        *_errors(errors, path_length(truth.poses)),
        "-",
        "-",
        f"{np.mean(spent):.0f}",
    ]


def _share(measured: list[bool]) -> str:
    return f"{100 * np.mean(measured):.1f} %"


def _errors(errors: list[object], path_length_m: float) -> list[str]:
    known = [float(str(error)) if error is not None else float("nan") for error in errors]
    return [cell for error in known for cell in (f"{error:.4f}", f"{100 * error / path_length_m:.2f}")]


def main() -> None:
    """Print a table with a line for each recording, sensor and program."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=existing, metavar="FOLDER")
    parser.add_argument("--sensor", nargs="+", choices=("mono", "depth"), default=["mono", "depth"])
    parser.add_argument("--orb-slam3", type=existing, metavar="PYTHON")
    parser.add_argument("--vocabulary", type=existing, metavar="FILE")
    parser.add_argument("--work", type=Path, default=Path("runs/indoors"))
    given = parser.parse_args()
    print(" | ".join(HEADINGS))
    for folder in given.folders:
        for sensor in given.sensor:
            work = given.work / f"{folder.name}-{sensor}"
            cells = revisit(folder, sensor, work / "revisit")
            print(" | ".join((folder.name, sensor, "Revisit", *cells)), flush=True)
            if given.orb_slam3 and given.vocabulary:
                cells = orb_slam3(folder.resolve(), sensor, work / "orb_slam3", given.orb_slam3, given.vocabulary)
                print(" | ".join((folder.name, sensor, "ORB-SLAM3", *cells)), flush=True)


if __name__ == "__main__":
    run_script(main)
