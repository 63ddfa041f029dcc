"""The interface of a dataset: what every format provides once it is opened, and what a user asks for.

`DatasetSpec` is the request: path, format and the values that the files do not contain. Every format finds the folder
of one sequence below the path with `find_dataset`.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from odometry.camera import StereoCamera
from place_recognition.image_processing.local_features import FeatureExtractor, LocalFeatures
from place_recognition.image_processing.static_regions import ImageMask, ImageMasks
from slam.errors import ConfigError, DataError

# Frames per second that a recording can have: from one image in eleven days to beyond any camera.
_MIN_FPS, _MAX_FPS = 1e-6, 1e6

_THUMBNAIL_SIDE = 8
_MAX_GREY_DIFFERENCE = 8  # of means over an eighth of the side: decoders differ by one or two grey values


@dataclass(frozen=True)
class Frame:
    """One rectified stereo pair, or one image of a dataset with one camera.

    Attributes:
        index: position in the dataset, from 0.
        timestamp: time of exposure, seconds.
        left: (H, W) uint8, grey, rectified.
        right: (H, W) uint8, or None in a dataset with one camera.
        features: local features of the left image; None until they are extracted.
        mask: which pixels of the left image were left out of them; None until they are extracted.
        depth: (H, W) float32, metres along the optical axis, registered to the left image; NaN where there is no
            measurement. None in a dataset without a depth camera.
        color: the left image in colour, (H, W, 3) uint8, red first; None where nobody asked, or there is only grey.
    """

    index: int
    timestamp: float
    left: NDArray[np.uint8]
    right: NDArray[np.uint8] | None
    features: LocalFeatures | None = None
    mask: ImageMask | None = None
    depth: NDArray[np.float32] | None = None
    color: NDArray[np.uint8] | None = None

    @property
    def usable_pixels(self) -> NDArray[np.uint8] | None:
        """(H, W) uint8, 0 where the left image is left out of features and odometry; None if it is used everywhere."""
        return None if self.mask is None else self.mask.pixels

    def with_features(self, extractor: FeatureExtractor, masks: ImageMasks | None = None) -> "Frame":
        """Return the frame with the features of its left image; itself where it has them.

        The masks, if any, see each frame once, in order, and say where its features may lie.
        """
        if self.features is not None:
            return self
        if masks is None:
            return replace(self, features=extractor.extract(self.left))
        mask = masks.observe(self.left)
        return replace(self, features=extractor.extract(self.left, mask.pixels), mask=mask)


class Dataset(Protocol):
    """A recorded sequence of frames. Images are read on demand; all other files are checked on opening."""

    @property
    def name(self) -> str:
        """Short name for titles and files."""
        ...

    @property
    def camera(self) -> StereoCamera:
        """Intrinsics and baseline of the rectified pair; with a depth camera, of the pair that it stands for."""
        ...

    @property
    def timestamps(self) -> NDArray[np.float64]:
        """(N,) seconds, increasing."""
        ...

    @property
    def ground_truth(self) -> NDArray[np.float64] | None:
        """T_world_camera (N, 4, 4), metres, or None where it is unknown."""
        ...

    @property
    def has_right(self) -> bool:
        """Whether there is a right image for each left image."""
        ...

    @property
    def has_depth(self) -> bool:
        """Whether there is a depth image for each left image."""
        ...

    @property
    def remarks(self) -> tuple[str, ...]:
        """Notes for the user about images that were left out and assumptions that were made on opening."""
        ...

    def __len__(self) -> int: ...

    def __getitem__(self, index: int) -> Frame: ...

    def __iter__(self) -> Iterator[Frame]: ...

    def read_left(self, index: int) -> NDArray[np.uint8]:
        """Read the left image of a frame alone, (H, W) as in the frame: half the time of the frame."""
        ...

    def read_color(self, index: int) -> NDArray[np.uint8] | None:
        """Read the left image of a frame in colour: (H, W, 3), RGB, rectified; None where there is only grey."""
        ...


def is_valid_fps(fps: float) -> bool:
    """Whether a number can be a frame rate, in images per second."""
    return _MIN_FPS <= fps <= _MAX_FPS


@dataclass(frozen=True)
class DatasetSpec:
    """A dataset to open, and how to read it.

    Attributes:
        path: folder or file.
        sequence: name of one of several sequences below the folder; None where there is only one.
        format: name of a format in `slam.datasets.formats.registry.FORMATS`; None to detect it.
        fps: images per second, for recordings without timestamps.
        topics: image topics of a bag, the left camera's first; empty to find them.
        left_only: whether the left camera alone is read, so that nothing about a right one matters.

    Raises:
        ConfigError: `fps` is not a frame rate, or there are more than two topics.
    """

    path: Path
    sequence: str | None = None
    format: str | None = None
    fps: float | None = None
    topics: tuple[str, ...] = ()
    left_only: bool = False

    def __post_init__(self) -> None:
        if self.fps is not None and not is_valid_fps(self.fps):
            raise ConfigError(f"--fps: expected images per second, above 0, found {self.fps}")
        if len(self.topics) > 2:
            raise ConfigError(f"--image-topic: expected one, or left and right, found {len(self.topics)}")

    def as_metrics(self) -> dict[str, object]:
        """Return the fields that were given, for metrics.json."""
        return {name: value for name, value in asdict(self).items() if value not in (None, (), False)}

    @classmethod
    def from_metrics(cls, fields: Mapping[str, Any]) -> "DatasetSpec":
        """Return the specification that `as_metrics` has written.

        Raises:
            KeyError, TypeError: the fields are not those of a specification.
        """
        rest = dict(fields)
        return cls(Path(rest.pop("path")), topics=tuple(rest.pop("topics", ())), **rest)


def subfolders(root: Path) -> list[Path]:
    """Folders in a folder, by name; an empty list if there is no such folder."""
    return sorted(item for item in root.iterdir() if item.is_dir()) if root.is_dir() else []


def contains_dataset(root: Path, is_dataset: Callable[[Path], bool]) -> bool:
    """Whether a folder is a dataset, or has one directly below it."""
    return root.is_dir() and (is_dataset(root) or any(is_dataset(folder) for folder in subfolders(root)))


def find_dataset(root: Path, sequence: str | None, is_dataset: Callable[[Path], bool], marker: str) -> Path:
    """Return the folder of one sequence: `root`, or the folder of that name directly below it.

    Args:
        root: folder that the user named.
        sequence: name of a folder below; None where there is only one dataset.
        is_dataset: whether a folder is a dataset of the format.
        marker: file by which the format is recognised, for the error message.

    Raises:
        DataError: there is no dataset, or there are several and none was named.
    """
    if sequence is None and is_dataset(root):
        return root
    datasets = {folder.name: folder for folder in subfolders(root) if is_dataset(folder)}
    if not datasets:
        raise DataError(f"{root}: expected {marker} in it or in a folder below, found none; check the path")
    name = sequence or next(iter(datasets))
    if name not in datasets or (sequence is None and len(datasets) > 1):
        wanted = f"one sequence {sequence}" if sequence else "one sequence"
        raise DataError(f"{root}: expected {wanted}, found {', '.join(datasets)}; choose one with --sequence")
    return datasets[name]


def thumbnail(image: NDArray[np.uint8]) -> str:
    """Return an image (H, W) uint8 as 8 x 8 grey values in hexadecimal, by which a recording is known again."""
    import cv2

    return cv2.resize(image, (_THUMBNAIL_SIDE, _THUMBNAIL_SIDE), interpolation=cv2.INTER_AREA).tobytes().hex()


def is_same_image(known: object, image: NDArray[np.uint8]) -> bool:
    """Whether an image (H, W) uint8 has the thumbnail of another; True where that one is not known."""
    if not isinstance(known, str) or len(known) != 2 * _THUMBNAIL_SIDE**2:
        return True
    there, here = (np.frombuffer(bytes.fromhex(text), np.uint8).astype(int) for text in (known, thumbnail(image)))
    return int(np.abs(there - here).max()) <= _MAX_GREY_DIFFERENCE


def read_color(images: object, index: int) -> NDArray[np.uint8] | None:
    """Read an image (H, W, 3), RGB; None if it is grey, or its reader has grey images alone."""
    read: Callable[[int], NDArray[np.uint8] | None] | None = getattr(images, "read_color", None)
    return None if read is None else read(index)
