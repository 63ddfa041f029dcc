"""Looks through a recording: opens it, reads some of its images, and judges what it finds."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from slam.datasets.dataset import Dataset
from slam.datasets.kinds import FORMATS, detect_format
from slam.datasets.left_images import ImageDataset
from slam.datasets.source import DatasetSpec
from slam.errors import DataError
from slam.evaluation.trajectory import path_length
from slam.inspection.calibration import judge_camera, judge_rows
from slam.inspection.finding import DRIVING, EVERYTHING, Finding, Inspection, Use, bad, doubtful, good
from slam.inspection.images import Looks, judge_images, look
from slam.inspection.times import judge_times

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Progress = Callable[[int, int], None]

_MOMENTS, _RUN = 40, 3  # places where successive images are looked at; three tell where each is there twice
_PAIRS = 8  # of left and right, in which rows are compared


@dataclass
class _Seen:
    """What was seen of the images: looks at all, looks at those after another one, pairs of left and right."""

    looks: list[Looks] = field(default_factory=list)
    successors: list[Looks] = field(default_factory=list)
    pairs: list[tuple[Image, Image]] = field(default_factory=list)
    fault: str = ""


def inspect(source: DatasetSpec, progress: Progress) -> Inspection:
    """Inspect a recording.

    Args:
        source: what to read.
        progress: told images looked at, and in all.

    Raises:
        DataError: there is nothing that can be recognised as a recording.
        ConfigError: a kind that does not exist.
    """
    kind = detect_format(source)
    try:
        drive = FORMATS[kind].open_dataset(source)
    except DataError as error:
        findings = _images_alone(source, kind, str(error), progress)
    else:
        findings = _drive(drive, progress)
    return Inspection(str(source.path), kind, tuple(findings))


def _images_alone(source: DatasetSpec, kind: str, trouble: str, progress: Progress) -> list[Finding]:
    """Judge what is left where a trouble keeps the recording from being opened as a drive."""
    try:
        images = FORMATS[kind].open_images(source)
    except DataError as error:
        if str(error) == trouble:
            return [bad("opening", trouble, EVERYTHING)]
        return [bad("opening", trouble, DRIVING), bad("images", str(error), (Use.PLACES,))]
    seen = _look_through(len(images), lambda index: (images[index], None), progress)
    times = [] if images.timestamps is None else judge_times(images.timestamps)
    return [bad("opening", trouble, DRIVING), _count(len(images), "images"), *_judge(seen), *times, _truth(images)]


def _drive(drive: Dataset, progress: Progress) -> list[Finding]:
    def read(index: int) -> tuple[Image, Image | None]:
        frame = drive[index]
        return frame.left, frame.right

    seen = _look_through(len(drive), read, progress)
    findings = [_count(len(drive), "pairs of images" if drive.has_right else "images"), *_judge(seen)]
    findings += [*judge_times(drive.timestamps), *judge_camera(drive.camera, drive.has_right)]
    if drive.has_right:
        findings.append(judge_rows(seen.pairs))
    else:
        findings.append(bad("second camera", "there are images of one camera", (Use.STEREO,)))
    findings.append(_truth(drive))
    return [*findings, *(doubtful("left out", remark) for remark in drive.remarks)]


def _look_through(count: int, read: Callable[[int], tuple[Image, Image | None]], progress: Progress) -> _Seen:
    """Look at images all over the recording, up to the first that cannot be read."""
    seen, indices = _Seen(), _spread(count)
    compared = set(np.linspace(0, len(indices) - 1, _PAIRS).astype(int).tolist())
    last, before = -1, None
    for done, index in enumerate(indices):
        try:
            left, right = read(index)
        except DataError as error:
            seen.fault = str(error)
            return seen
        follows = before is not None and index == last + 1
        seen.looks.append(look(left, before if follows else None))
        if follows:
            seen.successors.append(seen.looks[-1])
        if right is not None and done in compared:
            seen.pairs.append((left, right))
        last, before = index, left
        progress(done + 1, len(indices))
    return seen


def _spread(count: int) -> list[int]:
    """All images, or the runs of successive ones."""
    if count <= _MOMENTS * _RUN:
        return list(range(count))
    first = np.linspace(0, count - _RUN, _MOMENTS).astype(int)
    return [int(index) for index in (first[:, None] + np.arange(_RUN)).ravel()]


def _judge(seen: _Seen) -> list[Finding]:
    faults = [bad("images", seen.fault, EVERYTHING)] if seen.fault else []
    return faults + (judge_images(seen.looks, seen.successors) if seen.looks else [])


def _count(count: int, things: str) -> Finding:
    if count < 2:
        return bad("count", f"{count} {things}: a drive has more; check the folder", EVERYTHING, count=count)
    return good("count", f"{count} {things}", count=count)


def _truth(recording: Dataset | ImageDataset) -> Finding:
    try:
        poses = recording.ground_truth
    except DataError as error:
        return doubtful("ground truth", str(error))
    if poses is None:
        return good("ground truth", "none: errors will not be known", metres=None)
    metres = float(path_length(poses))
    return good("ground truth", f"{len(poses)} poses, {metres:.1f} m of way", metres=metres)
