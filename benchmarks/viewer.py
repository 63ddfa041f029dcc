"""Cost of the recording: milliseconds for each frame and megabytes for 1,000 frames, on made-up frames.

Run from the root: `python benchmarks/viewer.py [FOLDER_OF_IMAGES]`. The images decide the size of the
file; without a folder they are smooth noise of the size of KITTI's images.
"""

import argparse
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
from command_line import existing, run_script
from rich.console import Console
from rich.table import Table

from odometry.camera import StereoCamera
from slam.viewer.rerun_viewer import RerunViewer
from slam.viewer.viewer import FrameView, LoopView

FRAMES, TRACKS, LANDMARKS, IMAGES = 1000, 1200, 400, 40


def images(folder: Path | None, rng: np.random.Generator) -> list[np.ndarray]:
    """Read the first images of a folder, or make smooth noise."""
    if folder:
        return [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in sorted(folder.iterdir())[:IMAGES]]
    noise = rng.integers(0, 255, (IMAGES, 376, 1241)).astype(np.uint8)
    return [cv2.normalize(cv2.GaussianBlur(n, None, 2.0), None, 0, 255, cv2.NORM_MINMAX) for n in noise]


def step(index: int, image: np.ndarray, rng: np.random.Generator) -> FrameView:
    """Make a step with as many tracks and landmarks as a real one."""
    T = np.eye(4)
    T[:3, 3] = 100 * np.array([np.cos(index / 80), 0.0, np.sin(index / 80)])
    pixels = rng.uniform(0, 376, (TRACKS, 2))
    landmarks = T[:3, 3] + rng.normal(scale=10, size=(LANDMARKS, 3)) if index % 3 == 0 else None
    inliers = rng.random(TRACKS) < 0.85
    stages = dict.fromkeys(("read", "odometry", "features", "place recognition", "pose graph"), 10.0)
    return FrameView(index, index / 10, image, T, T, pixels, pixels + 3, inliers, False, landmarks, stages, 0.5, False)


def main() -> None:
    """Record the frames and print the cost."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=existing, nargs="?", help="folder of images")
    arguments = parser.parse_args()
    rng = np.random.default_rng(0)
    shown = images(arguments.folder, rng)
    height, width = shown[0].shape
    camera = StereoCamera(718.0, 718.0, width / 2, height / 2, 0.54, width, height)
    spent, spent_loops = [], []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.rrd"
        viewer = RerunViewer(path, camera)
        poses = np.tile(np.eye(4), (FRAMES, 1, 1))
        for index in range(FRAMES):
            now = step(index, shown[index % len(shown)], rng)
            poses[index] = now.T_world_camera
            start = time.perf_counter()
            viewer.show_frame(now)
            spent.append(time.perf_counter() - start)
            if index > 500 and index % 5 == 0:
                pixels = now.pixels_current[:100]
                loop = LoopView(index, index - 500, now.image, now.image, pixels, pixels, True, "a benchmark")
                start = time.perf_counter()
                viewer.show_loop(loop, poses[: index + 1])
                spent_loops.append(time.perf_counter() - start)
        viewer.close()
        size = path.stat().st_size / 1e6
    table = Table("", "median [ms]", "99th percentile [ms]", title=f"{FRAMES} frames, {size:.1f} MB")
    for name, seconds in (("step", spent), ("loop", spent_loops)):
        table.add_row(name, *(f"{1000 * np.percentile(seconds, p):.2f}" for p in (50, 99)))
    Console().print(table)


if __name__ == "__main__":
    run_script(main)
