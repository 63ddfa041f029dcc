"""A tiny KITTI drive: three stereo pairs of 64 x 32 pixels, one metre ahead for each frame."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from slam.io.trajectory_files import write_kitti

COUNT = 3
# x of the four cameras in camera 0's frame, metres: grey left, grey right, colour left, colour right
OFFSETS = (0.0, 0.4, -0.06, 0.35)


def projection_line(camera: int) -> str:
    return f"P{camera}: 50 0 31.5 {-50 * OFFSETS[camera]:g} 0 50 15.5 0 0 0 1 0"


def write_images(folder: Path, count: int = COUNT, channels: int = 1) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for index in range(count):
        image = np.random.default_rng(index).integers(0, 256, (32, 64, channels), dtype=np.uint8)
        cv2.imwrite(str(folder / f"{index:06d}.png"), image)


def _write_drive(root: Path, sequence: str = "00", cameras: tuple[int, ...] = (0, 1)) -> Path:
    folder = root / "sequences" / sequence
    for camera in cameras:
        write_images(folder / f"image_{camera}", channels=1 if camera < 2 else 3)
    (folder / "calib.txt").write_text("\n".join(projection_line(camera) for camera in range(4)) + "\n")
    (folder / "times.txt").write_text("".join(f"{0.1 * index:e}\n" for index in range(COUNT)))
    (root / "poses").mkdir(exist_ok=True)
    poses = np.repeat(np.eye(4)[None], COUNT, axis=0)
    poses[:, 2, 3] = np.arange(COUNT)
    write_kitti(root / "poses" / f"{sequence}.txt", poses)
    return folder


@pytest.fixture
def write_drive() -> Callable[..., Path]:
    """Writes a whole drive below a root and returns the folder of its sequence."""
    return _write_drive


@pytest.fixture
def root(tmp_path: Path) -> Path:
    _write_drive(tmp_path)
    return tmp_path


@pytest.fixture
def folder(root: Path) -> Path:
    return root / "sequences" / "00"
