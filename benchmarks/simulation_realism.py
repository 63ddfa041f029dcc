"""Compare the difficulty of the simulated town with that of real streets.

    python benchmarks/simulation_realism.py [DATASET ...]             folders in KITTI layout, sequence 00
    python benchmarks/simulation_realism.py --towns DIR [--difficulty street | --only ERROR] [--seeds 5]

Real clips are read from $REVISIT_TEST_DATA/kitti_clips. The second form drives the path of each clip, at its mean
speed, through towns of several seeds, so that curves and distances are alike; the drives are rendered into DIR. With
`--only` they are standard ones with a single one of the errors of a street, a field of `Difficulty`.

The first table is drift by two odometries: that of the product, and a plain one (corners, pyramidal Lucas-Kanade,
stereo by Lucas-Kanade, PnP with RANSAC; no window, no refinement). `--peer NAME FOLDER` adds one that has run
elsewhere: FOLDER has a file of poses in KITTI's layout for each dataset, named as in the table with "-" for " ". Drift
is the mean error over all stretches of 20, 30, 40 and 50 m: short clips have none of KITTI's 100 m. A ratio is that of
the drift in the towns to that on the clip whose path they have, by geometric means, in which all clips count alike.

The second table says what the drift consists of, for the odometry of the product: errors of the motion along the axes
of the camera in per cent of the distance, and of yaw and roll in per cent of the yaw. Its last columns are how far rows
of the left and the right image differ: smoothly over the image, locally, and over time.

The third table counts corners, track lengths and gradients, and has the drift of the plain odometry over 50 frames.
"""

import argparse
import itertools
import os
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import cv2
import numpy as np
from command_line import existing, run_script
from numpy.typing import NDArray
from odometry_drives import chain_poses

from odometry import StereoCamera, StereoOdometry, se3
from slam.evaluation.trajectory_errors import distances_along, path_length
from slam.io.trajectory_files import read_kitti
from slam.simulation import SimulationConfig, simulate
from slam.simulation.scenario.config import DIFFICULTIES, Difficulty

Array = NDArray[np.float64]
CLIPS = ("05", "06", "01")
SEGMENTS_M = (20.0, 30.0, 40.0, 50.0)
_LK = {"winSize": (21, 21), "maxLevel": 4}
_CORNERS = 1200
_FRAME_RATE_HZ = 10.0
_ROAD_AHEAD_M = 150.0


@dataclass
class Counts:
    """Measurements of one dataset, one number for each frame."""

    fast: list[int] = field(default_factory=list)
    corners: list[int] = field(default_factory=list)
    gradient: list[float] = field(default_factory=list)
    flat: list[float] = field(default_factory=list)
    mean: list[float] = field(default_factory=list)
    deviation: list[float] = field(default_factory=list)
    tracked: list[float] = field(default_factory=list)
    inliers: list[float] = field(default_factory=list)


@dataclass(frozen=True)
class Dataset:
    """One drive.

    Attributes:
        name: name in the tables.
        folder: folder in KITTI layout.
        sequence: number of the sequence.
        clip: number of the clip whose path it has; empty for others.
    """

    name: str
    folder: Path
    sequence: str
    clip: str = ""


@dataclass(frozen=True)
class Drive:
    """Images and truth of a dataset.

    Attributes:
        pairs: left and right images.
        K: (3, 3) calibration matrix.
        baseline_m: distance of the cameras.
        true: (N, 4, 4) true poses, the first the identity.
    """

    pairs: list[tuple[Array, Array]]
    K: Array
    baseline_m: float
    true: Array


def read_drive(dataset: Dataset, frames: int) -> Drive:
    """Read the first frames of a dataset."""
    base = dataset.folder / "sequences" / dataset.sequence
    rows = [line.split()[1:] for line in (base / "calib.txt").read_text().splitlines()[:2]]
    P0, P1 = (np.array(row, dtype=np.float64).reshape(3, 4) for row in rows)
    true = read_kitti(dataset.folder / "poses" / f"{dataset.sequence}.txt")[:frames]
    names = sorted((base / "image_0").glob("*.png"))[: len(true)]
    pairs = [(cv2.imread(str(p), 0), cv2.imread(str(base / "image_1" / p.name), 0)) for p in names]
    return Drive(pairs, P0[:, :3], -P1[0, 3] / P1[0, 0], se3.inverse(true[0]) @ true[: len(pairs)])


def render_towns(clips: Path, out: Path, difficulty: str, seeds: int) -> list[Dataset]:
    """Drive the path of each clip through towns of several seeds, unless that has been done."""
    datasets = []
    for clip, seed in itertools.product(CLIPS, range(seeds)):
        path = extend_path(clips / "poses" / f"{clip}.txt", out / f"path-{clip}.txt")
        count = len(list((clips / "sequences" / clip / "image_0").glob("*.png")))
        speed = _FRAME_RATE_HZ * path_length(read_kitti(path)[:count]) / (count - 1)  # of the clip, not beyond it
        name = f"{difficulty}-{clip}-{seed}"
        config = SimulationConfig(
            shape=str(path.resolve()), seed=seed, speed_m_per_s=round(float(speed), 2), difficulty=difficulty,
            max_frames=count,
        )  # fmt: skip
        datasets.append(Dataset(name, simulate(config, out / name), "00", clip))
    return datasets


def extend_path(clip: Path, out: Path) -> Path:
    """Write the path of a clip with a straight road behind its end, where there would be no town to look at."""
    poses = read_kitti(clip)
    step = (poses[-1, :3, 3] - poses[-4, :3, 3]) / 3
    count = int(np.ceil(_ROAD_AHEAD_M / np.linalg.norm(step)))
    beyond = np.tile(poses[-1], (count, 1, 1))
    beyond[:, :3, 3] += np.arange(1, count + 1)[:, None] * step
    out.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(out, np.concatenate([poses, beyond])[:, :3].reshape(-1, 12), fmt="%.9e")
    return out


def detect_corners(image: Array) -> Array:
    """Corners (N, 2), spread over the image."""
    found = cv2.goodFeaturesToTrack(image, _CORNERS, 0.005, 9)
    return found.reshape(-1, 2) if found is not None else np.zeros((0, 2), np.float32)


def track_corners(a: Array, b: Array, points: Array) -> tuple[Array, Array]:
    """Points of image a found in image b, and which came back to where they started within half a pixel."""
    there, ok, _ = cv2.calcOpticalFlowPyrLK(a, b, points, None, **_LK)
    back, ok_back, _ = cv2.calcOpticalFlowPyrLK(b, a, there, None, **_LK)
    good = (ok.ravel() > 0) & (ok_back.ravel() > 0) & (np.linalg.norm(back - points, axis=1) < 0.5)
    return there, good


def estimate_motion(before: tuple[Array, Array], now: tuple[Array, Array], drive: Drive, counts: Counts) -> Array:
    """T_before_now (4, 4) between two stereo pairs."""
    points = detect_corners(before[0])
    right, stereo = track_corners(before[0], before[1], points)
    disparity = points[:, 0] - right[:, 0]
    stereo &= (np.abs(points[:, 1] - right[:, 1]) < 1.5) & (disparity > 1.0)
    later, tracked = track_corners(before[0], now[0], points)
    use = stereo & tracked
    counts.tracked.append(tracked.mean())
    z = drive.K[0, 0] * drive.baseline_m / np.where(disparity > 0, disparity, 1)
    rays = (np.column_stack([points, np.ones(len(points))]) @ np.linalg.inv(drive.K).T) * z[:, None]
    cv2.setRNGSeed(0)
    found, r, t, inliers = cv2.solvePnPRansac(
        rays[use], later[use].astype(np.float64), drive.K, None, iterationsCount=200, reprojectionError=1.0
    )
    counts.inliers.append(len(inliers) / max(1, use.sum()) if found else 0.0)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = cv2.Rodrigues(r)[0], t.ravel()
    return np.linalg.inv(T)


def run_plain(drive: Drive, counts: Counts) -> Array:
    """Poses (N, 4, 4) by the plain odometry."""
    steps = [estimate_motion(before, now, drive, counts) for before, now in itertools.pairwise(drive.pairs)]
    return np.array(list(itertools.accumulate(steps, np.matmul, initial=np.eye(4))))


def run_product(drive: Drive) -> Array:
    """Poses (N, 4, 4) by the stereo odometry of the product."""
    height, width = drive.pairs[0][0].shape
    fx, fy, cx, cy = drive.K[0, 0], drive.K[1, 1], drive.K[0, 2], drive.K[1, 2]
    odometry = StereoOdometry(StereoCamera(fx, fy, cx, cy, drive.baseline_m, width, height))
    return chain_poses([odometry.track(*pair) for pair in drive.pairs])


def segment_drift(estimate: Array, true: Array) -> tuple[float, float]:
    """Mean errors over all stretches: per cent of their length, and degrees per 100 m; NaN where there is none."""
    along, errors = distances_along(true), []
    for length_m, first in itertools.product(SEGMENTS_M, range(len(true))):
        last = int(np.searchsorted(along, along[first] + length_m))
        if last >= len(true):
            continue
        error = se3.inverse(se3.inverse(true[first]) @ true[last]) @ se3.inverse(estimate[first]) @ estimate[last]
        errors.append((np.linalg.norm(error[:3, 3]) / length_m, np.degrees(se3.angle(error)) / length_m))
    translation, rotation = 100 * np.mean(errors, axis=0) if errors else (np.nan, np.nan)
    return float(translation), float(rotation)


def split_drift(estimate: Array, true: Array) -> str:
    """Mean errors of the motion between frames by cause, as cells of a table."""
    steps, found = se3.inverse(true[:-1]) @ true[1:], se3.inverse(estimate[:-1]) @ estimate[1:]
    error, length_m = se3.inverse(steps) @ found, path_length(true)
    moved = 100 * error[:, :3, 3].sum(axis=0) / length_m
    turned, wrong = (np.array([se3.log(T)[:3] for T in stack]) for stack in (steps, error))
    cells = [f"{value:+.2f}" for value in moved]
    yaw = turned[:, 1]
    total_deg = float(np.degrees(yaw.sum()))
    share = [f"{100 * yaw @ wrong[:, axis] / (yaw @ yaw):+.2f}" if abs(total_deg) > 30 else "-" for axis in (1, 2)]
    return " | ".join([*cells, f"{total_deg:.0f}", *share])


def row_errors(drive: Drive) -> str:
    """Rows that differ between left and right, pixels, as cells of a table.

    They are the peak of a quadratic polynomial over the image, the root mean square of what it leaves in 14 x 5 cells,
    and the standard deviation over time of the mean difference, less what its own noise explains.
    """
    places, differences, offsets, noise = [], [], [], []
    for left, right in drive.pairs[::2]:
        points = detect_corners(left)
        matched, good = track_corners(left, right, points)
        rows = matched[:, 1] - points[:, 1]
        good &= (points[:, 0] - matched[:, 0] > 0.5) & (np.abs(rows) < 3.0)
        places.append(2 * points[good] / left.shape[::-1] - 1)
        differences.append(rows[good])
    place, difference = np.concatenate(places), np.concatenate(differences)
    coefficients, keep = fit_rows(place, difference)
    rest = difference - quadratic_terms(place) @ coefficients
    for at, rows in zip(places, differences, strict=True):
        left_over = rows - quadratic_terms(at) @ coefficients
        left_over = left_over[np.abs(left_over) < 0.5]
        offsets.append(left_over.mean())
        noise.append(left_over.var() / len(left_over))
    cell = (((place + 1) / 2 * (14, 5)).astype(int) @ (5, 1))[keep]
    medians = [np.median(rest[keep][cell == k]) for k in range(70) if (cell == k).sum() > 60]
    grid = np.stack(np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 9)), axis=-1).reshape(-1, 2)
    peak = np.abs(quadratic_terms(grid) @ coefficients).max()
    moved = np.sqrt(max(0.0, np.var(offsets) - np.mean(noise)))
    return f"{peak:.2f} | {np.sqrt(np.mean(np.square(medians))):.3f} | {moved:.3f}"


def quadratic_terms(place: Array) -> Array:
    """Terms (N, 6) at places (N, 2)."""
    x, y = place.T
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)


def fit_rows(place: Array, difference: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Coefficients (6,) of the terms, and which differences (N,) agree with them."""
    terms, keep = quadratic_terms(place), np.ones(len(place), bool)
    for _ in range(4):
        coefficients = np.linalg.lstsq(terms[keep], difference[keep], rcond=None)[0]
        rest = np.abs(difference - terms @ coefficients)
        keep = rest < 4.5 * np.median(rest[keep])
    return np.asarray(coefficients), keep


def measure_image(image: Array, counts: Counts) -> None:
    """Count corners, gradients and brightness of a single image."""
    smooth = cv2.GaussianBlur(image, (0, 0), 1.0).astype(np.float32)
    slope = np.hypot(cv2.Sobel(smooth, cv2.CV_32F, 1, 0) / 8, cv2.Sobel(smooth, cv2.CV_32F, 0, 1) / 8)
    counts.fast.append(len(cv2.FastFeatureDetector_create(20).detect(image)))
    counts.corners.append(len(detect_corners(image)))
    counts.gradient.append(float(slope.mean()))
    counts.flat.append(float((slope < 1.0).mean()))
    counts.mean.append(float(image.mean()))
    counts.deviation.append(float(image.std()))


def track_lengths(lefts: list[Array]) -> float:
    """Mean number of frames, of 12, through which corners can be followed."""
    lengths = []
    for start in range(0, len(lefts) - 12, 12):
        points = detect_corners(lefts[start])
        alive = np.ones(len(points), bool)
        length = np.ones(len(points))
        for a, b in zip(lefts[start : start + 11], lefts[start + 1 : start + 12], strict=True):
            points, good = track_corners(a, b, points)
            alive &= good
            length += alive
        lengths.append(length.mean())
    return float(np.mean(lengths))


def format_counts(drive: Drive, plain: Array, counts: Counts) -> str:
    """Format what images and tracks of a drive are like, as cells of a table."""
    for left, _ in drive.pairs[1:]:
        measure_image(left, counts)
    windows = [
        window_drift(plain[start : start + 51], drive.true[start : start + 51])
        for start in range(0, len(drive.true) - 50, 10)
    ]
    spread = f"{min(windows):.2f}-{max(windows):.2f}" if windows else "-"
    numbers = [
        np.mean(windows) if windows else window_drift(plain, drive.true),
        np.mean(counts.fast),
        np.mean(counts.corners),
        np.mean(counts.gradient),
        100 * np.mean(counts.flat),
        np.mean(counts.mean),
        np.mean(counts.deviation),
        100 * np.mean(counts.tracked),
        100 * np.mean(counts.inliers),
    ]
    cells = [f"{n:.0f}" if n >= 100 else f"{n:.2f}" for n in numbers]
    return " | ".join([*cells, spread, f"{track_lengths([left for left, _ in drive.pairs]):.1f}"])


def window_drift(estimate: Array, true: Array) -> float:
    """End point error of a stretch, per cent of its length, both started from the same pose."""
    error = se3.inverse(se3.inverse(true[0]) @ true[-1]) @ se3.inverse(estimate[0]) @ estimate[-1]
    return float(100 * np.linalg.norm(error[:3, 3]) / path_length(true))


@dataclass(frozen=True)
class Row:
    """Results of one dataset.

    Attributes:
        dataset: what was measured.
        frames: number of its frames.
        drift: translation and rotation drift by the names of the odometries.
        split: cells of the second table.
        counts: cells of the third table.
    """

    dataset: Dataset
    frames: int
    drift: dict[str, tuple[float, float]]
    split: str
    counts: str


def measure(dataset: Dataset, frames: int, peers: list[tuple[str, Path]]) -> Row:
    """Run all odometries on a dataset."""
    drive, counts = read_drive(dataset, frames), Counts()
    plain, product = run_plain(drive, counts), run_product(drive)
    poses = {"Revisit": product, "KLT + PnP": plain}
    for name, folder in peers:
        file = folder / f"{dataset.name.replace(' ', '-')}.txt"
        poses[name] = read_kitti(existing(str(file)))[: len(drive.true)]
    split = f"{split_drift(product, drive.true)} | {row_errors(drive)}"
    drift = {name: segment_drift(estimate, drive.true) for name, estimate in poses.items()}
    cells = format_counts(drive, plain, counts)
    return Row(dataset, len(drive.pairs), drift, split, cells)


def geometric_mean(rows: list[Row], name: str) -> Array:
    """Drift (2,) of an odometry over several datasets."""
    return np.asarray(np.exp(np.mean(np.log([row.drift[name] for row in rows]), axis=0)))


def print_drift(rows: list[Row]) -> None:
    """Print the drift of each odometry on each dataset, and its ratio to that of the clip with the same path."""
    names = list(rows[0].drift)
    print("drift | frames | " + " | ".join(f"{name} %, deg/100 m" for name in names))
    for row in rows:
        cells = ["{:.2f}, {:.2f}".format(*row.drift[name]) for name in names]
        print(" | ".join([row.dataset.name, str(row.frames), *cells]))
    real = {row.dataset.clip: row for row in rows if row.dataset.clip == row.dataset.sequence}
    towns = {clip: [row for row in rows if row.dataset.clip == clip and row is not real[clip]] for clip in real}
    groups = [(clip, [real[clip]], towns[clip]) for clip in real if towns[clip]]
    if groups:
        all_towns = [row for _, _, inside in groups for row in inside]
        groups.append(("all", list(real.values()), all_towns))
    for clip, clips, inside in groups:
        ratios = [geometric_mean(inside, name) / geometric_mean(clips, name) for name in names]
        cells = ["{:.2f}, {:.2f}".format(*ratio) for ratio in ratios]
        print(" | ".join([f"ratio {clip}", str(len(inside)), *cells]), flush=True)


def print_cells(title: str, rows: list[Row], cells: Callable[[Row], str]) -> None:
    """Print one of the other tables."""
    print(f"\n{title}")
    for row in rows:
        print(f"{row.dataset.name} | {row.frames} | {cells(row)}", flush=True)


def choose_datasets(arguments: argparse.Namespace) -> list[Dataset]:
    """Datasets of the command line, after the real clips."""
    given = [Dataset(folder.name, folder, "00") for folder in arguments.datasets]
    if not os.environ.get("REVISIT_TEST_DATA"):
        return given
    clips = existing(os.environ["REVISIT_TEST_DATA"]) / "kitti_clips"
    real = [Dataset(f"KITTI {name}", clips, name, name) for name in CLIPS]
    towns = arguments.towns
    return [*real, *given, *(render_towns(clips, towns, arguments.difficulty, arguments.seeds) if towns else [])]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("datasets", nargs="*", type=existing)
    parser.add_argument("--frames", type=int, default=121)
    parser.add_argument("--towns", type=Path, metavar="DIR")
    parser.add_argument("--difficulty", default="street")
    parser.add_argument("--only", choices=[field.name for field in fields(Difficulty)], metavar="ERROR")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--peer", nargs=2, action="append", default=[], metavar=("NAME", "FOLDER"))
    arguments = parser.parse_args()
    if arguments.only:
        arguments.difficulty = f"standard-with-{arguments.only}"
        value = getattr(DIFFICULTIES["street"], arguments.only)
        DIFFICULTIES[arguments.difficulty] = replace(DIFFICULTIES["standard"], **{arguments.only: value})
    peers = [(name, existing(folder)) for name, folder in arguments.peer]
    rows = [measure(dataset, arguments.frames, peers) for dataset in choose_datasets(arguments)]
    print_drift(rows)
    print_cells("parts | frames | right % | down % | forward % | yaw deg | yaw error % | roll error % | "
                "row peak px | row local px | row drift px", rows,
                lambda row: row.split)  # fmt: skip
    print_cells("images | frames | drift % of 50 frames | FAST | corners | gradient | flat % | mean | deviation | "
                "tracked % | PnP inliers % | drift range | track length", rows, lambda row: row.counts)  # fmt: skip


if __name__ == "__main__":
    run_script(main)
