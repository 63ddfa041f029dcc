"""Small valid images, videos and bags."""

import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from ..slam.datasets import bags as small
from ..slam.datasets.layouts import BagStyle, taken, write_bag

SIZE = (16, 12)
IMAGE = np.random.default_rng(0).integers(0, 255, SIZE[::-1], np.uint8)


def written(name: str, write: Callable[[Path], object]) -> bytes:
    """What `write` writes into a file of a name."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        write(path)
        return path.read_bytes()


def image_files() -> list[bytes]:
    colour = np.dstack([IMAGE] * 3)
    deep = IMAGE.astype(np.uint16) << 8
    encoded = [(s, IMAGE) for s in (".png", ".jpg", ".bmp", ".pgm", ".tiff")]
    encoded += [
        (".png", colour),
        (".jpg", colour),
        (".ppm", colour),
        (".tiff", colour),
        (".png", deep),
        (".tiff", deep),
    ]
    return [cv2.imencode(suffix, image)[1].tobytes() for suffix, image in encoded]


def depth_files() -> list[bytes]:
    """Depth of 16 bits as PNG and TIFF, and of floats."""
    depth = IMAGE.astype(np.uint16) * 40
    metres = depth.astype(np.float32) / 1000
    encoded = ((".png", depth), (".tiff", depth), (".tiff", metres), (".pfm", metres))
    return [cv2.imencode(suffix, values)[1].tobytes() for suffix, values in encoded]


@cache
def depth_bag() -> bytes:
    """A bag of one colour camera and of depth that is registered to it."""
    messages = small.Messages().images("/camera/color/image_raw", [0.0, 0.1, 0.2])
    messages.add("/camera/color/camera_info", small.Info().message())
    for k in range(3):
        depth = np.full(small.SIZE[::-1], 1000 + k, np.uint16)
        message = small.raw_image(depth, small.START + 0.1 * k, "16UC1")
        messages.add("/camera/aligned_depth_to_color/image_raw", message)
    with tempfile.TemporaryDirectory() as name:
        return messages.write(Path(name) / "drive.bag").read_bytes()


def video_files() -> list[bytes]:
    return [written(name, lambda path, c=codec: _write_video(path, c)) for name, codec in VIDEOS]


VIDEOS = (("v.avi", "MJPG"), ("v.mp4", "mp4v"), ("v.mkv", "MJPG"))


def _write_video(path: Path, codec: str) -> None:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), 10, (32, 24))
    for k in range(3):
        writer.write(np.full((24, 32, 3), 60 * k, np.uint8))
    writer.release()


@cache
def bags() -> dict[str, bytes]:
    """A bag of each kind of storage, by the suffix of its file."""
    drive = taken("ideal", 3)
    grey = replace(drive, pairs=[(np.full_like(left, 90), np.full_like(right, 90)) for left, right in drive.pairs])
    with tempfile.TemporaryDirectory() as name:
        written = [write_bag(Path(name) / kind, grey, BagStyle(kind, "png")) for kind in ("ros1", "sqlite3", "mcap")]
        files = [path if path.is_file() else next(path.glob("drive*")) for path in written]
        metadata = {f"{file.suffix}.yaml": file.with_name("metadata.yaml").read_bytes() for file in files[1:]}
        return {file.suffix: file.read_bytes() for file in files} | metadata
