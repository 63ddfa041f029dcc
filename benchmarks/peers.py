"""Revisit and its peers side by side on the same stereo drives, one scorer for all.

    python benchmarks/peers.py DRIVE... [--repeat 3] [--libviso2 PROGRAM] [--rtabmap PROGRAM] [--out DIR]

A DRIVE is a KITTI root with one sequence, or ROOT:SEQUENCE, with `poses/` or, for a drive without, the relative poses
of `ROOT/loops_measured.csv`. The programs run one after the other, each as a process of its own:

* Revisit: `revisit run` with its defaults, without recording and map;
* ORB-SLAM3: the wheel pyorbslam3 (GPL-3) in an environment of its own, DIR/orb_slam3, which the script makes; its
  vocabulary (orb_vocabulary.py) is --vocabulary FILE, or trained on --vocabulary-images FOLDER..., which must judge
  nothing here, or else on a rendered drive;
* KLT + PnP: klt_odometry.py, a simple control;
* LIBVISO2 and RTAB-Map: programs of your own, called as `PROGRAM LEFT RIGHT CALIB TIMES OUT`: two folders of images,
  KITTI's calib.txt with P0 and P1, a file of times, and an empty folder, into which the program writes its poses as
  `odometry.txt` in KITTI's format, one line for each pair, and, where it closes loops, `corrected.txt` and `loops.csv`
  (columns query and match). peer_contract.py has the details.

Columns: ATE after SE(3) alignment before loop closing ("ATE m"; of ORB-SLAM3 the motions as they were tracked) and
after ("closed m"); ATE of the last of the two after Sim(3) alignment; t_rel, r_rel (deg per 100 m) and the end error
before loop closing, by KITTI's rule, on drives shorter than 100 m with segments of 10 to 80 m from every frame; loops,
true and false by the true poses. Without poses: the mean error of position and angle over the measured pairs.
"ms" and "cpu ms" are the wall-clock and the processor time of a frame: the time of the drive less that of its first
frames, so that loading and compiling do not count; reading images does. Where a program measures its frames itself
(ORB-SLAM3, which waits for the next frame), "ms" is their median. "MB" is the peak of the resident memory. A value is
the median of --repeat runs, ± half of their range. Only processor times count on a machine that has other work.

Place recognition and its peers: places.py.
"""

import argparse
import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from command_line import existing, run_script
from orb_vocabulary import DEFAULT_IMAGES, describe_images, train, write_text
from peer_programs import (
    ORB_SLAM3,
    Cost,
    Missing,
    Peer,
    PeerDrive,
    PeerError,
    Revisit,
    given_program,
    klt,
    make_environment,
    orb_slam3,
    read_drive,
    run_measured,
)
from peer_scores import (
    COST_COLUMNS,
    LOOP_COLUMNS,
    PAIR_COLUMNS,
    TRUTH_COLUMNS,
    Estimate,
    Scores,
    describe_spread,
    score_pairs,
    score_poses,
)
from rich.console import Console
from rich.table import Table

from odometry import se3
from slam.errors import RevisitError
from slam.evaluation.trajectory_errors import path_length
from slam.simulation import SimulationConfig, simulate

START_FRAMES = 10  # of the run that is subtracted
DIGITS = {"ATE m": 3, "closed m": 3, "Sim(3) m": 3, "t_rel %": 2, "r_rel deg": 2, "end %": 2, "pairs m": 3}
_RENDERED = SimulationConfig(shape="blocks", laps=1, length_m=400.0, seed=77, max_frames=DEFAULT_IMAGES)


@dataclass(frozen=True)
class PeerDrives:
    """A drive and its first frames.

    Attributes:
        whole: all frames.
        start: the first `START_FRAMES`.
    """

    whole: PeerDrive
    start: PeerDrive


def measure(peer: Peer, drives: PeerDrives, out: Path) -> tuple[Scores, str]:
    """Run a program on the start of a drive and on the whole drive. Returns all columns of its row, and its remark."""
    costs = [_run(peer, drive, out / name) for drive, name in ((drives.start, "start"), (drives.whole, "whole"))]
    estimate = peer.read(drives.whole, out / "whole")
    loops = dict(zip(LOOP_COLUMNS, (estimate.loops.count, estimate.loops.true, estimate.loops.false), strict=True))
    scores = _score(estimate, drives.whole)
    frames = drives.whole.frames - drives.start.frames
    return scores | loops | _frame_costs(costs[0], costs[1], frames, estimate.milliseconds), estimate.remark


def _run(peer: Peer, drive: PeerDrive, out: Path) -> Cost:
    return run_measured(peer.command(drive, out), out)


def _score(estimate: Estimate, drive: PeerDrive) -> Scores:
    return score_pairs(estimate, drive.pairs) if drive.truth is None else score_poses(estimate, drive.truth)


def _frame_costs(start: Cost, whole: Cost, frames: int, own_ms: float | None) -> Scores:
    wall_ms, cpu_ms = (
        1e3 * difference / frames if frames > 0 else None
        for difference in (whole.wall_s - start.wall_s, whole.cpu_s - start.cpu_s)
    )
    return {"ms": wall_ms if own_ms is None else own_ms, "cpu ms": cpu_ms, "MB": whole.peak_mb}


def compare(peers: Sequence[Peer], drives: PeerDrives, repeat: int, out: Path) -> tuple[Table, list[str]]:
    """Run all programs on a drive. Returns the table and the remarks of the programs."""
    drive, remarks = drives.whole, []
    columns = (*(PAIR_COLUMNS if drive.truth is None else TRUTH_COLUMNS), *LOOP_COLUMNS, *COST_COLUMNS)
    table = Table("program", *columns, title=describe(drive), title_justify="left")
    for number, peer in enumerate(peers):
        folder = out / str(number)
        try:
            runs = [measure(peer, drives, folder / str(index)) for index in range(repeat)]
        except (PeerError, RevisitError) as error:
            table.add_row(peer.name)
            remarks.append(f"{peer.name}: {error}")
            continue
        table.add_row(peer.name, *(_cell(column, [scores[column] for scores, _ in runs]) for column in columns))
        remarks += dict.fromkeys(f"{peer.name}: {remark}" for _, remark in runs if remark)
    return table, remarks


def _cell(column: str, values: Sequence[float | None]) -> str:
    return describe_spread(values, DIGITS.get(column, 1 if column.endswith("deg") else 0))


def describe(drive: PeerDrive) -> str:
    """Describe a drive in a line."""
    if drive.truth is None:
        return f"{drive.name}: {drive.frames} pairs, {len(drive.pairs)} measured relative poses"
    length, turns = path_length(drive.truth), se3.inverse(drive.truth[:-1]) @ drive.truth[1:]
    fastest = max(np.degrees(se3.angle(turn)) for turn in turns)
    return f"{drive.name}: {drive.frames} pairs, {length:.0f} m, turns of up to {fastest:.1f} deg a frame"


def prepare_orb_slam3(given: argparse.Namespace) -> Peer:
    """Make the environment and the vocabulary of ORB-SLAM3, unless they are there."""
    try:
        python = make_environment(given.out / "orb_slam3", (ORB_SLAM3, "opencv-python-headless"))
    except PeerError as error:
        return Missing("ORB-SLAM3", str(error))
    vocabulary = given.vocabulary or given.out / "orb_vocabulary.txt"
    if not vocabulary.exists():
        folders = given.vocabulary_images or [simulate(_RENDERED, given.out / "vocabulary_images")]
        write_text(vocabulary, train(describe_images(folders, DEFAULT_IMAGES)))
    return orb_slam3(python, vocabulary)


def find_drive(text: str) -> tuple[Path, str | None]:
    """Return the root and the sequence of ROOT or ROOT:SEQUENCE; None for the only sequence.

    Raises:
        DataError: there is no such root.
    """
    root, _, sequence = (text, "", "") if Path(text).exists() else text.rpartition(":")
    return existing(root or text), sequence or None


def open_drives(root: Path, sequence: str | None, folder: Path) -> PeerDrives:
    """Lay out a drive in a new folder."""
    parts = (("whole", None), ("start", START_FRAMES))
    whole, start = (read_drive(root, sequence, folder / name, frames) for name, frames in parts)
    return PeerDrives(whole, start)


def parse() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("drives", nargs="+", metavar="DRIVE")
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--libviso2", type=existing, metavar="PROGRAM")
    parser.add_argument("--rtabmap", type=existing, metavar="PROGRAM")
    parser.add_argument("--vocabulary", type=existing, metavar="FILE")
    parser.add_argument("--vocabulary-images", type=existing, nargs="+", metavar="FOLDER")
    parser.add_argument("--out", type=Path, default=Path("runs/peers"), help="environments, and the last runs")
    return parser.parse_args()


def main() -> None:
    """Compare on each drive."""
    given = parse()
    sources = [find_drive(text) for text in given.drives]
    runs = given.out / "runs"
    shutil.rmtree(runs, ignore_errors=True)
    drives = [open_drives(*source, runs / str(number) / "drive") for number, source in enumerate(sources)]
    peers: list[Peer] = [
        Revisit(),
        prepare_orb_slam3(given),
        klt(),
        given_program("LIBVISO2", given.libviso2, "--libviso2"),
        given_program("RTAB-Map", given.rtabmap, "--rtabmap"),
    ]
    console = Console(width=170)
    print(
        f"{os.cpu_count()} processors, load {os.getloadavg()[0]:.1f}; median of {given.repeat} runs, ± half the range"
    )
    for number, drive in enumerate(drives):
        table, remarks = compare(peers, drive, given.repeat, runs / str(number))
        console.print(table)
        for remark in remarks:
            print(remark)


if __name__ == "__main__":
    run_script(main)
