"""A second drive through the streets of a first one: are they joined, and where does the first map place images of it?

    revisit simulate blocks --laps 2 --length 800 --lateral-offset 1.5 --relight --alike --moving-cars 8 \
        --seed 7 --out data/blocks7
    python benchmarks/second_drive.py data/blocks7 --out DIR

Cuts a drive of two laps, in KITTI layout, in the middle; drives the first half, then the second through its map, and
places images of the second in the map of the first alone.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from scipy.spatial.transform import Rotation

from slam.datasets.source import DatasetSpec
from slam.evaluation.trajectory import absolute_trajectory_error, path_length, umeyama
from slam.localisation.command import Answer, LocateOptions, locate
from slam.localisation.locator import Located
from slam.map_store.store import MapStore, map_file
from slam.storage.trajectory import read_kitti

Array = NDArray[np.float64]
SEQUENCE = "sequences/00"
NEAR_M, NEAR_DEG, WRONG_M = 0.5, 2.0, 5.0


def revisit(*words: object) -> None:
    """Run the command line in a process of its own."""
    subprocess.run([sys.executable, "-c", "from slam.cli import main; main()", *map(str, words)], check=True)


def cut(drive: Path, frames: range, out: Path) -> Path:
    """Some frames of a drive as a drive of its own, its images linked."""
    for eye in ("image_0", "image_1"):
        (out / SEQUENCE / eye).mkdir(parents=True)
        for number, frame in enumerate(frames):
            image = drive.resolve() / SEQUENCE / eye / f"{frame:06d}.png"
            (out / SEQUENCE / eye / f"{number:06d}.png").symlink_to(image)
    (out / SEQUENCE / "calib.txt").write_text((drive / SEQUENCE / "calib.txt").read_text())
    times = (drive / SEQUENCE / "times.txt").read_text().splitlines()
    (out / SEQUENCE / "times.txt").write_text("".join(f"{times[frame]}\n" for frame in frames))
    return out


def chosen(drive: Path, frames: Array, out: Path) -> Path:
    """A folder with some of a drive's left images."""
    out.mkdir()
    for frame in frames:
        (out / f"{frame:06d}.png").symlink_to(drive.resolve() / SEQUENCE / "image_0" / f"{frame:06d}.png")
    return out


def errors(answers: Iterable[Answer], mapped: Array, truth: Array) -> tuple[Array, Array]:
    """Metres and degrees of those found, once the map's poses (M, 4, 4) were laid on the truth of the first frames."""
    laid = umeyama(mapped[:, :3, 3], truth[: len(mapped), :3, 3])
    found = [
        (answer.found, truth[int(Path(answer.name).stem)]) for answer in answers if isinstance(answer.found, Located)
    ]
    metres = [np.linalg.norm(laid.apply(at.T_world_camera[:3, 3]) - T[:3, 3]) for at, T in found]
    turns = [(laid.R @ at.T_world_camera[:3, :3]).T @ T[:3, :3] for at, T in found]
    return np.array(metres), np.degrees(Rotation.from_matrix(np.array(turns)).magnitude())


def main() -> None:
    """Drive twice, place, and print what came of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("drive", type=Path)
    parser.add_argument("--out", type=Path, required=True, help="a folder that does not exist yet")
    parser.add_argument("--images", type=int, default=200, help="of the second half that are placed")
    arguments = parser.parse_args()
    drive, out = arguments.drive, arguments.out
    truth = read_kitti(drive / "poses/00.txt")
    middle = len(truth) // 2
    one, other = cut(drive, range(middle), out / "one"), cut(drive, range(middle, len(truth)), out / "other")
    revisit("run", one, "--out", out / "first", "--no-record")
    revisit("run", other, "--map", out / "first", "--out", out / "second", "--no-record")
    asked = np.linspace(middle, len(truth) - 1, arguments.images).astype(int)
    asked_for = LocateOptions(out / "first", DatasetSpec(chosen(drive, asked, out / "asked")))
    answers = locate(asked_for, Console(stderr=True))
    told = json.loads((out / "second/metrics.json").read_text())["map"]
    with MapStore.open(map_file(out / "second")) as store:
        both = store.poses()
    with MapStore.open(map_file(out / "first")) as store:
        mapped = store.poses()
    ate, way = absolute_trajectory_error(both, truth), path_length(truth)
    print(f"joined: {told['joined']}, by {told['kept']} loops; ATE of both {ate:.3f} m of {way:.0f} m")
    metres, degrees = errors(answers, mapped, truth)
    near = int(((metres <= NEAR_M) & (degrees <= NEAR_DEG)).sum())
    print(
        f"placed {len(metres)} of {len(asked)}, {near} within {NEAR_M} m and {NEAR_DEG} degrees,"
        f" {int((metres > WRONG_M).sum())} off by over {WRONG_M} m; largest error {metres.max():.2f} m"
    )


if __name__ == "__main__":
    main()
