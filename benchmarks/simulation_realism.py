"""Compare the difficulty of the simulated town with that of real streets.

The same plain odometry (corners, pyramidal Lucas-Kanade, stereo by Lucas-Kanade, PnP with RANSAC; no window, no
refinement) runs on each dataset; corners, track lengths and gradients are counted too. Usage:

    python benchmarks/simulation_realism.py DATASET [DATASET ...]      folders in KITTI layout, sequence 00

Real clips are read from $REVISIT_TEST_DATA/kitti_clips if that variable is set.
"""

import argparse
import itertools
import os
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from command_line import existing, run_script
from numpy.typing import NDArray

Array = NDArray[np.float64]
CLIPS = ("05", "06", "01")
_LK = {"winSize": (21, 21), "maxLevel": 4}
_CORNERS = 1200


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


def read_dataset(folder: Path, sequence: str, frames: int) -> tuple[list[tuple[Array, Array]], Array, float, Array]:
    """Stereo pairs, calibration matrix (3, 3), baseline in metres and true poses (N, 4, 4)."""
    base = folder / "sequences" / sequence
    rows = [line.split()[1:] for line in (base / "calib.txt").read_text().splitlines()[:2]]
    P0, P1 = (np.array(row, dtype=np.float64).reshape(3, 4) for row in rows)
    poses = np.loadtxt(folder / "poses" / f"{sequence}.txt", ndmin=2)[:frames].reshape(-1, 3, 4)
    names = sorted((base / "image_0").glob("*.png"))[: len(poses)]
    pairs = [(cv2.imread(str(p), 0), cv2.imread(str(base / "image_1" / p.name), 0)) for p in names]
    true = np.tile(np.eye(4), (len(poses), 1, 1))
    true[:, :3] = poses
    return pairs, P0[:, :3], -P1[0, 3] / P1[0, 0], np.linalg.inv(true[0]) @ true


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


def estimate_motion(
    before: tuple[Array, Array], now: tuple[Array, Array], K: Array, baseline: float, counts: Counts
) -> Array:
    """T_before_now (4, 4) between two stereo pairs."""
    points = detect_corners(before[0])
    right, stereo = track_corners(before[0], before[1], points)
    disparity = points[:, 0] - right[:, 0]
    stereo &= (np.abs(points[:, 1] - right[:, 1]) < 1.5) & (disparity > 1.0)
    later, tracked = track_corners(before[0], now[0], points)
    use = stereo & tracked
    counts.tracked.append(tracked.mean())
    z = K[0, 0] * baseline / np.where(disparity > 0, disparity, 1)
    rays = (np.column_stack([points, np.ones(len(points))]) @ np.linalg.inv(K).T) * z[:, None]
    cv2.setRNGSeed(0)
    found, r, t, inliers = cv2.solvePnPRansac(
        rays[use], later[use].astype(np.float64), K, None, iterationsCount=200, reprojectionError=1.0
    )
    counts.inliers.append(len(inliers) / max(1, use.sum()) if found else 0.0)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = cv2.Rodrigues(r)[0], t.ravel()
    return np.linalg.inv(T)


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


def format_row(name: str, pairs: list[tuple[Array, Array]], K: Array, baseline: float, true: Array) -> str:
    """Run the odometry on one dataset and format its line of the table."""
    counts, at, windows = Counts(), np.eye(4), []
    estimate = [at]
    for before, now in itertools.pairwise(pairs):
        measure_image(now[0], counts)
        at = at @ estimate_motion(before, now, K, baseline, counts)
        estimate.append(at)
    for start in range(0, len(true) - 50, 10):
        windows.append(window_drift(np.array(estimate[start : start + 51]), true[start : start + 51]))
    end = window_drift(np.array(estimate), true)
    drift = float(np.mean(windows)) if windows else end
    spread = f"{min(windows):.2f}-{max(windows):.2f}" if windows else "-"
    numbers = [
        drift,
        np.mean(counts.fast),
        np.mean(counts.corners),
        np.mean(counts.gradient),
        100 * np.mean(counts.flat),
    ]
    numbers += [
        np.mean(counts.mean),
        np.mean(counts.deviation),
        100 * np.mean(counts.tracked),
        100 * np.mean(counts.inliers),
    ]
    cells = [f"{n:.0f}" if n >= 100 else f"{n:.2f}" for n in numbers]
    return " | ".join([name, str(len(pairs)), *cells, spread, f"{track_lengths([p[0] for p in pairs]):.1f}"])


def window_drift(estimate: Array, true: Array) -> float:
    """End point error of a stretch, per cent of its length, both started from the same pose."""
    error = np.linalg.inv(np.linalg.inv(true[0]) @ true[-1]) @ (np.linalg.inv(estimate[0]) @ estimate[-1])
    length_m = np.linalg.norm(np.diff(true[:, :3, 3], axis=0), axis=1).sum()
    return float(100 * np.linalg.norm(error[:3, 3]) / length_m)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("datasets", nargs="*", type=existing)
    parser.add_argument("--frames", type=int, default=121)
    arguments = parser.parse_args()
    sources = [(folder.name, folder, "00") for folder in arguments.datasets]
    if os.environ.get("REVISIT_TEST_DATA"):
        clips = Path(os.environ["REVISIT_TEST_DATA"]) / "kitti_clips"
        sources = [(f"KITTI {name}", clips, name) for name in CLIPS] + sources
    print("dataset | frames | drift % of 50 frames | FAST | corners | gradient | flat % | mean | deviation | "
          "tracked % | PnP inliers % | drift range | track length")  # fmt: skip
    for name, folder, sequence in sources:
        print(format_row(name, *read_dataset(folder, sequence, arguments.frames)), flush=True)


if __name__ == "__main__":
    run_script(main)
