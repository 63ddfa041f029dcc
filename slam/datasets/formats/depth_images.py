"""Depth images of RGB-D recordings: files and lists, and their association with the colour images.

Depth is registered: pixel by pixel it belongs to the colour image. It is optional: a recording whose depth cannot be
used is one of a single camera, and a remark gives the reason.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from slam.datasets.depth_units import MILLIMETRES, Depth, describe_scale, median_depth, to_metres, usual_scale
from slam.datasets.formats.image_sequence import (
    IMAGE_SUFFIXES,
    check_name,
    find_numbers,
    read_times,
    sort_by_name,
    times_from_names,
)
from slam.datasets.formats.timestamped_lists import ListFormat, read_image_list
from slam.datasets.time_sync import associate_with_nearest, short_name
from slam.errors import DataError

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

DEPTH_UNUSED = "the depth is not used"  # end of the remark that says why depth is not used

DEPTH_SUFFIXES = (IMAGE_SUFFIXES - {".jpg", ".jpeg", ".jpe", ".webp", ".jp2"}) | {".npy", ".pfm"}
# Between a colour image and its depth: half a frame and its jitter. In freiburg1_rpy of TUM all 723 images have a depth
# image so near; with pairs of which each is nearest to the other, as for two cameras, there are 671 and 51 gaps.
_MAX_OFFSET_FRAMES = 0.65
_MAX_OFFSET_S = 0.05  # of slow cameras: at 1 rad/s an image moves by 25 pixels in this time


class DepthImages(Protocol):
    """The raw depth images of one camera in the order of their exposure."""

    @property
    def units_per_m(self) -> float:
        """Scale of the stored values."""
        ...

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> Depth:
        """Read depth (H, W), metres, NaN where there is none. Raises DataError where it cannot be read."""
        ...

    def where(self, index: int) -> str:
        """File of a depth image and its position in the file, for error messages."""
        ...


@dataclass(frozen=True)
class DepthFiles:
    """Files of depth images (a DepthImages).

    Attributes:
        files: N paths, in order.
        units_per_m: scale of the values.
    """

    files: tuple[Path, ...]
    units_per_m: float

    def __len__(self) -> int:
        return len(self.files)

    def __getitem__(self, index: int) -> Depth:
        """Read depth (H, W), metres, NaN where there is none."""
        path = self.files[index]
        try:
            return to_metres(_read_values(path), self.units_per_m)
        except ValueError as error:
            raise DataError(f"{path}: {error}") from None

    def where(self, index: int) -> str:
        """Path of a depth image, for error messages."""
        return str(self.files[index])


@dataclass(frozen=True)
class DepthSubset:
    """A selection of depth images (a DepthImages).

    Attributes:
        images: all depth images.
        indices: (N,) of the selected ones, which never decrease; two colour images may have one depth image.
    """

    images: DepthImages
    indices: Indices
    _last: dict[int, Depth] = field(default_factory=dict, repr=False)  # a bag would be opened again to read it again

    @property
    def units_per_m(self) -> float:
        """Scale of the stored values."""
        return self.images.units_per_m

    def __len__(self) -> int:
        return len(self.indices)

    def __getitem__(self, index: int) -> Depth:
        """Read a selected depth image (H, W), metres, NaN where there is none."""
        number, last = int(self.indices[index]), dict(self._last)
        depth = last[number] if number in last else self.images[number]
        self._last.clear()
        self._last[number] = depth
        return depth

    def where(self, index: int) -> str:
        """File of a selected depth image, for error messages."""
        return self.images.where(int(self.indices[index]))


@dataclass(frozen=True)
class DepthStream:
    """Depth images with their times.

    Attributes:
        images: N depth images.
        timestamps: (N,) seconds, never decreasing.
        remarks: notes for the user about the times.
    """

    images: DepthImages
    timestamps: Array
    remarks: tuple[str, ...] = ()

    def subset(self, indices: Indices) -> "DepthStream":
        """Return the depth images of some indices (K,), which never decrease."""
        if np.array_equal(indices, np.arange(len(self.timestamps))):
            return self
        return replace(self, images=DepthSubset(self.images, indices), timestamps=self.timestamps[indices])


def _read_values(path: Path) -> NDArray[Any]:
    """Values of a depth image as they are stored. Raises ValueError if it cannot be read."""
    check_name(path)
    if not path.is_file():
        raise ValueError("expected a depth image, found none; was the recording moved, or its disk taken out?")
    try:
        values = _load_array(path) if path.suffix.lower() == ".npy" else cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    except (
        Exception
    ):  # whatever a damaged byte provokes in a header: cv2.error, ValueError, TokenError, MemoryError, ...
        values = None
    if values is None:
        raise ValueError("expected a depth image, found a file that cannot be read; copy it again")
    return values


def _load_array(path: Path) -> NDArray[Any]:
    values = np.array(np.lib.format.open_memmap(path, mode="r"))  # the header's size must be that of the file
    return values[..., 0] if values.ndim == 3 and values.shape[2] == 1 else values


def read_depth_list(
    path: Path, folder: Path, list_format: ListFormat, columns: tuple[int, int], units_per_m: float
) -> DepthStream:
    """Read depth images whose names and times are in columns of a list (see `read_image_list`).

    Raises:
        DataError: the list is damaged, or an image is missing.
    """
    listed = read_image_list(path, folder, list_format, columns)
    assert listed.timestamps is not None
    return DepthStream(DepthFiles(listed.files, units_per_m), listed.timestamps, listed.remarks)


def open_depth_folder(folder: Path, colour_times: Array, units_per_m: float | None) -> DepthStream:
    """Open a folder of depth images: their times are in its `times.txt`, in their names, or those of the colour images.

    Args:
        folder: folder of the depth images.
        colour_times: (N,) of the colour images; they are those of the depth images if there are N of these.
        units_per_m: scale of the values; None for the usual one of their type.

    Raises:
        DataError: there are no depth images, or their times are unknown.
    """
    files = _list_depth_files(folder)
    if not files:
        raise DataError(
            f"{folder}: expected depth images ({' '.join(sorted(DEPTH_SUFFIXES))}), found none; check depth"
        )
    times, remarks = _find_times(folder, files, colour_times)
    return DepthStream(DepthFiles(files, units_per_m or _find_scale(files[0])), times, remarks)


def _find_scale(path: Path) -> float:
    try:
        return usual_scale(_read_values(path))
    except ValueError:  # which reading the image will report
        return MILLIMETRES


def _list_depth_files(folder: Path) -> tuple[Path, ...]:
    if not folder.is_dir():
        return ()
    return sort_by_name(f for f in folder.iterdir() if f.suffix.lower() in DEPTH_SUFFIXES and f.name[0] != ".")


def _find_times(folder: Path, files: Sequence[Path], colour_times: Array) -> tuple[Array, tuple[str, ...]]:
    if (folder / "times.txt").is_file():
        return read_times(folder / "times.txt", len(files))
    own, remarks = times_from_names(files)
    if own is not None:
        return own, remarks
    if len(files) == len(colour_times):
        return colour_times, ()
    numbers = find_numbers(files)
    if numbers is not None and numbers[0] >= 0 and numbers[-1] < len(colour_times):
        return colour_times[numbers], (f"{folder.name}: depth images belong to the colour images of their numbers",)
    raise DataError(
        f"{folder}: expected {len(colour_times)} depth images as there are colour images, found {len(files)}, and"
        " nothing that says which belong together; copy them again, or write their times into times.txt there"
    )


@dataclass(frozen=True)
class MatchedDepth:
    """Depth images and the colour images that they belong to.

    Attributes:
        depth: K depth images; None if they cannot be used.
        colour_indices: (K,) of their colour images; all if they cannot be used.
        remarks: what was left out and why.
    """

    depth: DepthStream | None
    colour_indices: Indices
    remarks: tuple[str, ...] = ()


def match_depth(depth: DepthStream, colour_times: Array, size: tuple[int, int]) -> MatchedDepth:
    """Associate depth images with colour images by time, and check what depth must be to be used.

    Args:
        depth: all depth images.
        colour_times: (N,) seconds, increasing.
        size: width and height of the colour images.
    """
    everything = np.arange(len(colour_times))
    step_s = float(np.median(np.diff(colour_times))) if len(colour_times) > 1 else _MAX_OFFSET_S
    max_offset_s = min(_MAX_OFFSET_FRAMES * step_s, _MAX_OFFSET_S)
    pairs = associate_with_nearest(depth.timestamps, colour_times, max_offset_s)
    if not len(pairs):
        where = depth.images.where(0)
        trouble = f"{where}: expected depth within {max_offset_s:.3g} s of colour images, found none;"
        return MatchedDepth(None, everything, (*depth.remarks, f"{trouble} {DEPTH_UNUSED}"))
    matched = depth.subset(pairs[:, 1])
    fault, remarks = _inspect(matched.images, size)
    if fault:
        return MatchedDepth(None, everything, (*depth.remarks, f"{fault}; {DEPTH_UNUSED}"))
    alone = len(colour_times) - len(pairs)
    words = [f"{alone} images without a depth image within {max_offset_s:.3g} s are left out"] if alone else []
    return MatchedDepth(matched, pairs[:, 0], (*depth.remarks, *words, *remarks))


def _inspect(images: DepthImages, size: tuple[int, int]) -> tuple[str, tuple[str, ...]]:
    """Read some depth images: why they cannot be used, and a remark if their scale is wrong."""
    medians = []
    for index in sorted({0, len(images) // 2, len(images) - 1}):
        try:
            depth = images[index]
        except DataError as error:
            return str(error), ()
        if depth.shape != (size[1], size[0]):
            found = f"found {depth.shape[1]} x {depth.shape[0]}: it is not registered to the colour"
            return f"{images.where(index)}: expected depth of {size[0]} x {size[1]} pixels, {found}", ()
        medians.append(median_depth(depth))
    median_m = float(np.nanmedian(medians)) if np.isfinite(medians).any() else 1.0
    trouble = describe_scale(median_m, images.units_per_m)
    return "", (f"{short_name(Path(images.where(0)))}: {trouble}",) if trouble else ()
