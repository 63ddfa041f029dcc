"""A second drive through the streets of a first one: merging of both into one map, and localisation in the first map.

    revisit simulate blocks --difficulty standard --laps 2 --length 800 --lateral-offset 1.5 --change-illumination \
        --perceptual-aliasing --cars-per-360m 8 --seed 7 --out data/blocks7
    python benchmarks/second_drive.py data/blocks7 --out DIR

A drive of two laps, in KITTI layout, is cut in the middle. The first half is run, then the second half with the map of
the first, and images of the second half are localised in the map of the first alone.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from command_line import existing, run_script
from numpy.typing import NDArray
from rich.console import Console
from scipy.spatial.transform import Rotation

from slam.apps.localize import LocateOptions, QueryResult, locate
from slam.datasets.dataset import DatasetSpec
from slam.evaluation.trajectory_errors import absolute_trajectory_error, path_length, umeyama
from slam.io.trajectory_files import read_kitti
from slam.localization.localizer import LocalizationResult
from slam.map_database.database import MapDatabase, map_file

Array = NDArray[np.float64]
SEQUENCE = "sequences/00"
NEAR_M, NEAR_DEG, WRONG_M = 0.5, 2.0, 5.0


def revisit(*words: object) -> None:
    """Run the command line in a process of its own."""
    subprocess.run([sys.executable, "-c", "from slam.cli.app import main; main()", *map(str, words)], check=True)


def cut(drive: Path, frames: range, out: Path) -> Path:
    """Make a drive from some frames of another one, with links to its images."""
    for camera in ("image_0", "image_1"):
        (out / SEQUENCE / camera).mkdir(parents=True)
        for number, frame in enumerate(frames):
            image = drive.resolve() / SEQUENCE / camera / f"{frame:06d}.png"
            (out / SEQUENCE / camera / f"{number:06d}.png").symlink_to(image)
    (out / SEQUENCE / "calib.txt").write_text((drive / SEQUENCE / "calib.txt").read_text())
    times = (drive / SEQUENCE / "times.txt").read_text().splitlines()
    (out / SEQUENCE / "times.txt").write_text("".join(f"{times[frame]}\n" for frame in frames))
    return out


def link_images(drive: Path, frames: Array, out: Path) -> Path:
    """Make a folder with links to some left images of a drive."""
    out.mkdir()
    for frame in frames:
        (out / f"{frame:06d}.png").symlink_to(drive.resolve() / SEQUENCE / "image_0" / f"{frame:06d}.png")
    return out


def errors(answers: Iterable[QueryResult], mapped: Array, truth: Array) -> tuple[Array, Array]:
    """Return errors of the localised images, metres and degrees, after alignment of map poses (M, 4, 4) and truth."""
    alignment = umeyama(mapped[:, :3, 3], truth[: len(mapped), :3, 3])
    found = [
        (answer.found, truth[int(Path(answer.name).stem)])
        for answer in answers
        if isinstance(answer.found, LocalizationResult)
    ]
    metres = [np.linalg.norm(alignment.apply(at.T_world_camera[:3, 3]) - T[:3, 3]) for at, T in found]
    turns = [(alignment.R @ at.T_world_camera[:3, :3]).T @ T[:3, :3] for at, T in found]
    return np.array(metres), np.degrees(Rotation.from_matrix(np.array(turns)).magnitude())


def main() -> None:
    """Run both drives, localise the images, and print the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("drive", type=existing)
    parser.add_argument("--out", type=Path, required=True, help="a folder that does not exist yet")
    parser.add_argument(
        "--images", type=int, default=200, help="number of images of the second half that are localised"
    )
    arguments = parser.parse_args()
    drive, out = arguments.drive, arguments.out
    truth = read_kitti(drive / "poses/00.txt")
    middle = len(truth) // 2
    one, other = cut(drive, range(middle), out / "one"), cut(drive, range(middle, len(truth)), out / "other")
    revisit("run", one, "--out", out / "first", "--no-record")
    revisit("run", other, "--map", out / "first", "--out", out / "second", "--no-record")
    queries = np.linspace(middle, len(truth) - 1, arguments.images).astype(int)
    options = LocateOptions(out / "first", DatasetSpec(link_images(drive, queries, out / "queries")))
    answers = locate(options, Console(stderr=True))
    merge = json.loads((out / "second/metrics.json").read_text())["map"]
    with MapDatabase.open(map_file(out / "second")) as store:
        both = store.poses()
    with MapDatabase.open(map_file(out / "first")) as store:
        mapped = store.poses()
    ate, length_m = absolute_trajectory_error(both, truth), path_length(truth)
    print(f"joined: {merge['joined']}, by {merge['kept']} loops; ATE of both {ate:.3f} m of {length_m:.0f} m")
    metres, degrees = errors(answers, mapped, truth)
    near = int(((metres <= NEAR_M) & (degrees <= NEAR_DEG)).sum())
    print(
        f"localised {len(metres)} of {len(queries)}, {near} within {NEAR_M} m and {NEAR_DEG} degrees,"
        f" {int((metres > WRONG_M).sum())} off by over {WRONG_M} m; largest error {metres.max():.2f} m"
    )


if __name__ == "__main__":
    run_script(main)
