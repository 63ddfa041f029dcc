"""A day of driving: time, memory and size of all files over a drive that repeats the same laps.

    python benchmarks/long_drive.py OUT [--repeat 20] [--size half] [--base DRIVE] [--no-record] [--no-control]
    python benchmarks/long_drive.py OUT --replay 100000 --size small

The laps are those of `revisit simulate circle --laps 3 --length 360 --speed 12`, or a drive in KITTI layout with true
poses. They are repeated by links to their images: the last pose of the laps and the first are chosen so that the camera
goes on from one to the other as it does everywhere else. Times go on, the true poses are repeated. `--build-only`
leaves it at the drive, OUT/drive, which `revisit run` takes.

`--replay` takes motions, landmarks and local features of the laps from a first run, and repeats them for so many
frames: place recognition, loop closing, pose graph and all files do their work, odometry and extraction of features
do not. Its odometry makes the same errors in each round.

Printed for each tenth of the drive: milliseconds by stage, median and 99th percentile, memory, and the size of each
file; then the seconds of each step after the last frame, and the ratios of the last tenth to the second. Ratios within
a run count, and processor time: wall time depends on what else the machine does. The control are the laps once.
"""

import argparse
import json
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from command_line import existing, run_script
from long_drive_measurement import Measurement, draw, measure, print_measurement
from rich.console import Console

from odometry import se3
from place_recognition.recognizer import MatrixSink
from slam.components import build_components, build_extractor, build_loop_verifier
from slam.config import RunConfig
from slam.datasets.dataset import Dataset, DatasetSpec, Frame
from slam.datasets.formats.registry import open_dataset
from slam.errors import DataError
from slam.io.files import read_numbers
from slam.io.run_folder import RunFolder
from slam.keyframes import KeyFrameConfig
from slam.map_database.database import MAP_FILE, MapDatabase
from slam.map_database.replay import Build, ReplayedLandmarks, ReplayedOdometry
from slam.pipeline.pipeline import Pipeline, RunOptions, resolve_config, run_pipeline
from slam.simulation.scenario.config import SimulationConfig
from slam.simulation.simulator import simulate
from slam.system import Components

Array = np.ndarray
Item = TypeVar("Item")

_SIZES = {"full": (1241, 376), "half": (620, 188), "small": (320, 96)}
_JOIN_SHARE = 0.2  # of the laps' frames, at either end, in which the join is sought
_METRES_PER_RADIAN = 10.0  # by which a turn counts against a distance in the choice of the join
_CONSOLE = Console(width=200)


@dataclass(frozen=True)
class Round:
    """Which frames of the laps are repeated.

    Attributes:
        first, last: the frame that follows the last one, and the last one.
        excess_m, excess_deg: by how much the motion between them differs from the motion before it.
    """

    first: int
    last: int
    excess_m: float
    excess_deg: float

    def frames(self, repeat: int) -> Array:
        """Numbers of the frames of the laps for a drive of so many rounds; the first one begins with frame 0."""
        again = np.arange(self.first, self.last + 1)
        return np.concatenate([np.arange(self.last + 1), *[again] * (repeat - 1)])


def find_round(poses: Array) -> Round:
    """Choose the join of poses (N, 4, 4) whose motion is most like the motion before it."""
    reach = max(int(_JOIN_SHARE * len(poses)), 2)
    first = np.arange(reach)
    best = None
    for last in range(len(poses) - reach, len(poses)):
        expected = poses[last] @ se3.inverse(poses[last - 1]) @ poses[last]
        excess = se3.inverse(expected) @ poses[first]
        metres = np.linalg.norm(excess[:, :3, 3], axis=1)
        radians = np.array([se3.angle(T) for T in excess])
        cost = metres + _METRES_PER_RADIAN * radians
        k = int(cost.argmin())
        if best is None or cost[k] < best[0]:
            best = cost[k], Round(int(first[k]), last, float(metres[k]), float(np.degrees(radians[k])))
    assert best is not None
    return best[1]


def build_drive(base: Path, out: Path, repeat: int) -> Round:
    """Write a drive that repeats a drive in KITTI layout, by links to its images.

    Raises:
        DataError: the drive has no true poses.
    """
    (sequence,) = (base / "sequences").iterdir()
    truth = base / "poses" / f"{sequence.name}.txt"
    if not truth.is_file():
        raise DataError(f"{truth}: expected the true poses, by which laps are joined, found none; give another drive")
    rows = read_numbers(truth, 12)
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3] = rows.reshape(-1, 3, 4)
    chosen = find_round(poses)
    frames = chosen.frames(repeat)
    target = out / "sequences" / sequence.name
    for side in ("image_0", "image_1"):
        images = sorted((sequence / side).glob("*.png"))
        (target / side).mkdir(parents=True, exist_ok=True)
        for k, frame in enumerate(frames.tolist()):
            link = target / side / f"{k:06d}.png"
            if not link.is_symlink():
                link.symlink_to(images[frame].resolve())
    times = np.loadtxt(sequence / "times.txt")
    np.savetxt(target / "times.txt", np.median(np.diff(times)) * np.arange(len(frames)), fmt="%.6f")
    (target / "calib.txt").write_bytes((sequence / "calib.txt").read_bytes())
    (out / "poses").mkdir(exist_ok=True)
    np.savetxt(out / "poses" / truth.name, rows[frames], fmt="%.9g")
    return chosen


class Repeated(Sequence[Item]):
    """What a first run has measured, repeated: its first round once, its second one from then on."""

    def __init__(self, items: Sequence[Item], begin: int, count: int) -> None:
        self._items, self._begin, self._count = items, begin, count

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: int) -> Item:  # type: ignore[override]
        if not 0 <= index < self._count:
            raise IndexError(index)
        period = len(self._items) - self._begin
        return self._items[index if index < self._begin else self._begin + (index - self._begin) % period]


class RepeatedDataset:
    """Two rounds of a drive as one of many (a Dataset), with the local features of their images."""

    def __init__(self, rounds: Dataset, begin: int, count: int, config: RunConfig) -> None:
        assert rounds.ground_truth is not None
        self.name, self.camera, self.remarks = rounds.name, rounds.camera, ()
        self.has_right, self.has_depth = True, False
        self._at = Repeated(range(len(rounds)), begin, count)
        index = np.array([self._at[k] for k in range(count)])
        self.ground_truth = rounds.ground_truth[index]
        self.timestamps = np.median(np.diff(rounds.timestamps)) * np.arange(count)
        self._rounds = rounds
        extractor = build_extractor(config.place_recognition)
        self._features = [extractor.extract(frame.left) for frame in rounds]

    def __len__(self) -> int:
        return len(self._at)

    def __getitem__(self, index: int) -> Frame:
        k = self._at[index]
        frame = self._rounds[k]
        return Frame(index, float(self.timestamps[index]), frame.left, frame.right, self._features[k])

    def __iter__(self):
        return (self[index] for index in range(len(self)))

    def read_left(self, index: int) -> Array:
        """Read the left image of a frame alone."""
        return self._rounds.read_left(self._at[index])

    def read_color(self, index: int) -> None:
        """There is only grey."""


def repeated_components(map_file: Path, begin: int, count: int) -> Build:
    """Build components that repeat the motions and landmarks of a map."""
    with MapDatabase.open(map_file) as store:
        frames = list(store.frames())
    motions = Repeated([frame.motion for frame in frames], begin, count)
    landmarks = Repeated([frame.landmarks for frame in frames], begin, count)

    def build(camera, config: RunConfig, rows: MatrixSink | None = None) -> Components:
        odometry = ReplayedOdometry(motions, has_metric_scale=True)
        components = build_components(camera, config, rows)
        components = Components(**{**vars(components), "odometry": odometry})
        loop_closer = build_loop_verifier(ReplayedLandmarks(landmarks, camera, components, config), config)
        return Components(**{**vars(components), "loop_closer": loop_closer})

    return build


def run_images(drive: Path, out: Path, settings: dict[str, object]) -> Measurement:
    """Run a drive and measure it."""
    options = RunOptions(source=drive, out=out, overwrite=True)
    return measure(lambda messages: run_pipeline(options, settings, messages, messages), out)


def run_replay(arguments: argparse.Namespace, rounds: Path, chosen: Round, settings: dict[str, object]) -> Measurement:
    """Run two rounds, then repeat what was measured."""
    first, out = arguments.out / "run_rounds", arguments.out / "run_replay"
    run_images(rounds, first, settings | {"save_recording": False, "key_frames": KeyFrameConfig(max_revisits=10**9)})
    options = RunOptions(source=rounds, out=out, overwrite=True)
    config, begin = resolve_config(options, settings), chosen.last + 1
    dataset = RepeatedDataset(open_dataset(DatasetSpec(rounds)), begin, arguments.replay, config)
    pipeline = Pipeline(
        options=options,
        dataset=dataset,
        config=config,
        run_id="replay",
        open_folder=lambda: RunFolder.create(out, overwrite=True),
        build=repeated_components(first / MAP_FILE, begin, arguments.replay),
    )
    return measure(lambda messages: pipeline.run(messages, messages), out)


def base_drive(arguments: argparse.Namespace) -> Path:
    """The laps that are repeated, rendered if need be."""
    if arguments.base is not None:
        return Path(arguments.base)
    width, height = _SIZES[arguments.size]
    laps = SimulationConfig(shape="circle", laps=3, length_m=360.0, speed_m_per_s=12.0, width=width, height=height)
    return simulate(laps, arguments.out / f"laps_{arguments.size}")


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="folder for drives, runs, figures.json and the plot")
    parser.add_argument("--base", type=existing, help="drive in KITTI layout whose laps are repeated")
    parser.add_argument("--size", choices=sorted(_SIZES), default="half", help="of the images of the simulated laps")
    parser.add_argument("--repeat", type=int, default=20, help="how often the laps are driven")
    parser.add_argument("--replay", type=int, default=0, help="frames of a replay in place of a run on images")
    parser.add_argument("--paradigm", default="tracked-words")
    parser.add_argument("--robust", default=RunConfig().robust)
    parser.add_argument("--no-record", action="store_true", help="without the recording")
    parser.add_argument("--no-control", action="store_true", help="without a run of the laps alone")
    parser.add_argument("--build-only", action="store_true", help="only write the drive")
    return parser.parse_args(arguments)


def main() -> None:
    """Build the drive, run it, and print what it cost."""
    arguments = parse()
    arguments.out.mkdir(parents=True, exist_ok=True)
    base = base_drive(arguments)
    drive = arguments.out / ("rounds" if arguments.replay else "drive")
    chosen = build_drive(base, drive, 2 if arguments.replay else arguments.repeat)
    _CONSOLE.print(
        f"{drive}: frame {chosen.first} follows frame {chosen.last}; this motion differs from the one before it by "
        f"{chosen.excess_m:.3f} m and {chosen.excess_deg:.2f} deg",
        soft_wrap=True,
    )
    if arguments.build_only:
        return
    settings = {
        "paradigm": arguments.paradigm,
        "robust": arguments.robust,
        "save_recording": not arguments.no_record,
    }
    found: dict[str, Measurement] = {}
    if not arguments.no_control:
        found["control: the laps once"] = run_images(base, arguments.out / "run_control", settings)
    if arguments.replay:
        found[f"replay of {arguments.replay} frames"] = run_replay(arguments, drive, chosen, settings)
    else:
        found[f"{arguments.repeat} times the laps"] = run_images(drive, arguments.out / "run", settings)
    for title, measurement in found.items():
        print_measurement(_CONSOLE, title, measurement)
    draw(measurement, title, arguments.out / "long_drive.png")
    figures = {title: measurement.as_json() for title, measurement in found.items()}
    (arguments.out / "figures.json").write_text(json.dumps(figures, indent=1) + "\n")
    _CONSOLE.print(f"{os.cpu_count()} processors, load {os.getloadavg()[0]:.1f}; Python {sys.version.split()[0]}")


if __name__ == "__main__":
    run_script(main)
