"""The programs that `peers.py` compares: how each is started, measured and read."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from peer_scores import Estimate, Loops, MeasuredPair, count_loops, read_pairs

from slam.datasets.formats.kitti import KittiDataset, open_kitti
from slam.errors import DataError
from slam.io.files import read_numbers, read_text
from slam.io.trajectory_files import read_kitti

Array = NDArray[np.float64]

HERE = Path(__file__).parent
LOG = "log.txt"
MEASURED_PAIRS = "loops_measured.csv"
ORB_SLAM3 = "pyorbslam3==0.1.1"
_ORB_SLAM3_LOOPS = ("*Loop detected", "*Merge detected")  # what it prints when it closes one


class PeerError(Exception):
    """A program cannot run on a drive; the message is the reason, in a few words."""


@dataclass(frozen=True)
class PeerDrive:
    """A stereo drive as the programs get it: KITTI's layout, grey or colour images 000000 to N - 1.

    Attributes:
        root: folder with `sequences/00`.
        name: name for people.
        frames: number of pairs.
        truth: true T_world_camera (N, 4, 4), metres; None if unknown.
        pairs: relative poses that were measured by other means; empty where there are none.
    """

    root: Path
    name: str
    frames: int
    truth: Array | None
    pairs: Sequence[MeasuredPair] = ()

    @property
    def sequence(self) -> Path:
        """Folder of images, calibration and times."""
        return self.root / "sequences" / "00"

    def arguments(self, out: Path) -> list[str]:
        """Return the arguments of a program (`peer_contract`)."""
        files = ("image_0", "image_1", "calib.txt", "times.txt")
        return [*(str(self.sequence / name) for name in files), str(out)]


@dataclass(frozen=True)
class Cost:
    """What a child process used.

    Attributes:
        wall_s: wall-clock time, seconds.
        cpu_s: processor time of all its threads, seconds.
        peak_mb: peak of its resident memory, megabytes.
    """

    wall_s: float
    cpu_s: float
    peak_mb: float


class Peer(Protocol):
    """A program that estimates trajectories."""

    @property
    def name(self) -> str:
        """Name in the table."""
        ...

    def command(self, drive: PeerDrive, out: Path) -> list[str]:
        """Return the command that runs it on a drive, with results in a folder.

        Raises:
            PeerError: it cannot be run here.
        """
        ...

    def read(self, drive: PeerDrive, out: Path) -> Estimate:
        """Read its results.

        Raises:
            DataError: they are missing or damaged.
        """
        ...


@dataclass(frozen=True)
class Revisit:
    """This checkout: the whole pipeline with its report, without recording and map."""

    name: str = "Revisit"

    def command(self, drive: PeerDrive, out: Path) -> list[str]:
        """Return the command."""
        start = [sys.executable, "-c", "from slam.cli.app import main; main()", "run", str(drive.root)]
        return [*start, "--out", str(out / "run"), "--no-record", "--no-map"]

    def read(self, drive: PeerDrive, out: Path) -> Estimate:
        """Read the trajectories and the counted loops."""
        folder = out / "run"
        loops = json.loads(read_text(folder / "metrics.json"))["loops"]
        odometry, corrected = (read_kitti(folder / f"trajectory_{name}.txt") for name in ("odometry", "corrected"))
        return Estimate(odometry, corrected, Loops(loops["kept"], loops["true"], loops["false"]))


@dataclass(frozen=True)
class Program:
    """A program with the command line of `peer_contract`.

    Attributes:
        name: name in the table.
        start: the beginning of its command.
        options: the end of its command.
        loop_lines: beginnings of lines that it prints for each closed loop, where it does not write loops.csv.
    """

    name: str
    start: tuple[str, ...]
    options: tuple[str, ...] = ()
    loop_lines: tuple[str, ...] = ()

    def command(self, drive: PeerDrive, out: Path) -> list[str]:
        """Return the command."""
        return [*self.start, *drive.arguments(out), *self.options]

    def read(self, drive: PeerDrive, out: Path) -> Estimate:
        """Read what the program wrote and printed."""
        corrected, spent, remark = (out / name for name in ("corrected.txt", "milliseconds.txt", "remark.txt"))
        return Estimate(
            _read_poses(out / "odometry.txt", drive.frames),
            _read_poses(corrected, drive.frames) if corrected.exists() else None,
            self._loops(drive, out),
            float(np.median(read_numbers(spent, 1))) if spent.exists() else None,
            read_text(remark).strip() if remark.exists() else "",
        )

    def _loops(self, drive: PeerDrive, out: Path) -> Loops:
        if (out / "loops.csv").exists():
            rows = np.loadtxt(out / "loops.csv", delimiter=",", skiprows=1, ndmin=2).astype(int)
            return count_loops([(int(query), int(match)) for query, match in rows], drive.truth)
        if not self.loop_lines:
            return Loops()
        lines = read_text(out / LOG).splitlines()
        return Loops(sum(line.startswith(self.loop_lines) for line in lines))


@dataclass(frozen=True)
class Missing:
    """A program that cannot run here.

    Attributes:
        name: name in the table.
        reason: why, in a few words.
    """

    name: str
    reason: str

    def command(self, drive: PeerDrive, out: Path) -> list[str]:
        """Say why not."""
        raise PeerError(self.reason)

    def read(self, drive: PeerDrive, out: Path) -> Estimate:
        """Say why not."""
        raise PeerError(self.reason)


def klt() -> Program:
    """Return the simple control."""
    return Program("KLT + PnP", (sys.executable, str(HERE / "klt_odometry.py")))


def given_program(name: str, path: Path | None, option: str) -> Peer:
    """Return a program that stands on the command line, or that it does not."""
    if path is None:
        return Missing(name, f"not given ({option} PROGRAM)")
    return Program(name, (str(path.absolute()),))


def orb_slam3(python: Path, vocabulary: Path) -> Program:
    """Return ORB-SLAM3 in an environment of its own."""
    start = (str(python), str(HERE / "orb_slam3.py"))
    return Program("ORB-SLAM3", start, ("--vocabulary", str(vocabulary)), _ORB_SLAM3_LOOPS)


def make_environment(folder: Path, packages: Sequence[str]) -> Path:
    """Make a virtual environment with packages, unless it is there. Returns its interpreter.

    Raises:
        PeerError: the packages cannot be installed.
    """
    python, log = folder / "bin" / "python", folder.with_suffix(".log")
    if (folder / "complete").exists():
        return python
    folder.parent.mkdir(parents=True, exist_ok=True)
    with log.open("wb") as file:
        for command in (
            [sys.executable, "-m", "venv", str(folder)],
            [str(python), "-m", "pip", "install", "--disable-pip-version-check", *packages],
        ):
            if subprocess.run(command, stdout=file, stderr=subprocess.STDOUT, check=False).returncode:
                raise PeerError(f"not installed: {last_line(log)}")
    (folder / "complete").touch()
    return python


def read_drive(root: Path, sequence: str | None, folder: Path, frames: int | None = None) -> PeerDrive:
    """Lay out a KITTI sequence, or its first frames, in a folder for all programs.

    Raises:
        DataError: it is no stereo drive, or has neither true poses nor measured pairs.
    """
    drive = open_kitti(root, sequence)
    count = min(len(drive), frames or len(drive))
    pairs = read_pairs(root / MEASURED_PAIRS) if (root / MEASURED_PAIRS).exists() else ()
    if drive.files.right is None or (drive.ground_truth is None and not pairs):
        raise DataError(
            f"{root}: expected a stereo drive with poses/{drive.name}.txt or {MEASURED_PAIRS}, found none;"
            " name a drive whose truth is known"
        )
    _write_layout(drive, count, folder / "sequences" / "00")
    truth = None if drive.ground_truth is None else drive.ground_truth[:count]
    if truth is not None:
        (folder / "poses").mkdir(exist_ok=True)
        np.savetxt(folder / "poses" / "00.txt", truth[:, :3].reshape(-1, 12), fmt="%.12g")
    return PeerDrive(folder, f"{root.absolute().name} {drive.name}", count, truth, pairs)


def _write_layout(drive: KittiDataset, count: int, folder: Path) -> None:
    for side, files in (("image_0", drive.files.left), ("image_1", drive.files.right or ())):
        (folder / side).mkdir(parents=True)
        for index, file in enumerate(files[:count]):
            (folder / side / f"{index:06d}{file.suffix}").symlink_to(file.absolute())
    camera = drive.camera
    rows = {"P0": 0.0, "P1": -camera.fx * camera.baseline}
    lines = [
        f"{name}: {camera.fx!r} 0 {camera.cx!r} {shift!r} 0 {camera.fy!r} {camera.cy!r} 0 0 0 1 0\n"
        for name, shift in rows.items()
    ]
    (folder / "calib.txt").write_text("".join(lines))
    np.savetxt(folder / "times.txt", drive.timestamps[:count], fmt="%.9g")


def run_measured(command: Sequence[str], out: Path) -> Cost:
    """Run a command as a child process, with what it prints in `out/log.txt`, and measure it.

    Raises:
        PeerError: it cannot be started, or fails.
    """
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    cost = out.with_name(f"{out.name}.json")
    environment = os.environ | {"PYTHONPATH": str(HERE.parent)}
    with (out / LOG).open("wb") as log:
        subprocess.run(
            [sys.executable, "-S", str(HERE / "child_cost.py"), str(cost), *command],
            stdout=log, stderr=subprocess.STDOUT, env=environment, check=True,
        )  # fmt: skip
    used = json.loads(cost.read_text())
    if used["exit_code"]:
        raise PeerError(f"ended with {used['exit_code']:g}: {last_line(out / LOG)}")
    return Cost(used["wall_s"], used["cpu_s"], used["peak_mb"])


def last_line(log: Path) -> str:
    """Return the last line of a log that says something."""
    lines = [line.strip() for line in log.read_text(errors="replace").splitlines() if line.strip()]
    return lines[-1] if lines else "nothing printed"


def _read_poses(path: Path, frames: int) -> Array:
    poses = read_kitti(path)
    if len(poses) != frames:
        raise DataError(f"{path}: expected {frames} poses, found {len(poses)}; write one for each pair")
    return poses
