"""Read a dataset format of your own: streams of images, a calibration, and poses become a rectified dataset.

    python examples/9_own_dataset.py [--out runs/examples]

Writes a small dataset in the new format, opens it, and leaves 9_own_dataset.png: a pair of its images.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np
from street import output_folder

from slam.datasets.distortion_models import CameraModel
from slam.datasets.formats.recording import (
    RawRecording,
    RectifiedDataset,
    build_dataset,
    read_ground_truth,
    read_stream,
)
from slam.datasets.formats.timestamped_lists import ListFormat
from slam.datasets.rectification import rectify_parallel
from slam.io.trajectory_files import write_tum

# The format: left.list and right.list with "milliseconds;file" in each line, and ground truth in poses.tum.
LISTS = ListFormat(separator=";", ticks_per_second=1e3)
CAMERA = CameraModel(fx=120.0, fy=120.0, cx=79.5, cy=59.5)
BASELINE_M = 0.2


def is_own_format(folder: Path) -> bool:
    """Return whether a folder is a dataset in this format."""
    return (folder / "left.list").is_file() and (folder / "right.list").is_file()


def open_own_format(folder: Path) -> RectifiedDataset:
    """Open a dataset; a missing or damaged file raises a DataError that names it."""
    left = read_stream(folder / "left.list", folder, LISTS)
    recording = RawRecording(
        name=folder.name,
        left=left,
        right=read_stream(folder / "right.list", folder, LISTS),
        ground_truth=read_ground_truth(folder / "poses.tum", left),
    )
    return build_dataset(recording, lambda size: rectify_parallel(CAMERA, size, BASELINE_M))


def write_example(folder: Path, frames: int = 5) -> None:
    """Write a wall 2 m ahead, seen by a camera that moves 0.1 m to the right from frame to frame."""
    folder.mkdir(parents=True, exist_ok=True)
    wall = np.random.default_rng(0).integers(0, 256, (120, 400), dtype=np.uint8)
    for side, offset_m in (("left", 0.0), ("right", BASELINE_M)):
        lines = []
        for k in range(frames):
            shift = round(CAMERA.fx * (0.1 * k + offset_m) / 2.0)  # pixels by which the wall moves to the left
            cv2.imwrite(str(folder / f"{side}_{k}.png"), wall[:, shift : shift + 160])
            lines.append(f"{100 * k};{side}_{k}.png\n")
        (folder / f"{side}.list").write_text("".join(lines))
    poses = np.tile(np.eye(4), (frames, 1, 1))
    poses[:, 0, 3] = 0.1 * np.arange(frames)
    write_tum(folder / "poses.tum", 0.1 * np.arange(frames), poses)


parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--out", type=output_folder, default="runs/examples", help="folder of the results")
given = parser.parse_args()
folder = given.out / "own_dataset"
write_example(folder)
dataset = open_own_format(folder)
frame = dataset[3]
disparity = dataset.camera.fx * dataset.camera.baseline / 2.0
print(f"{dataset.name}: {len(dataset)} stereo pairs of {frame.left.shape[1]} x {frame.left.shape[0]} pixels")
print(
    f"frame 3 at {frame.timestamp:.1f} s, {dataset.ground_truth[3, 0, 3]:.1f} m to the right; the wall's disparity is"
)
print(f"{disparity:.0f} px: {np.array_equal(frame.left[:, int(disparity) :], frame.right[:, : -int(disparity)])}")
cv2.imwrite(str(given.out / "9_own_dataset.png"), np.hstack([frame.left, frame.right]))
