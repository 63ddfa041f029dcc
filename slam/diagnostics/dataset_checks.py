"""Checks of a dataset: opens it, reads some of its images, and collects the findings."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.static_regions import ImageMasks
from slam.datasets.dataset import Dataset, DatasetSpec
from slam.datasets.depth_units import Depth
from slam.datasets.formats.recording import ImageDataset
from slam.datasets.formats.registry import FORMATS, detect_format, open_images
from slam.diagnostics.depth_checks import DepthStatistics, check_depth, measure_depth
from slam.diagnostics.findings import (
    ALL_USES,
    SLAM_USES,
    Finding,
    Inspection,
    Use,
    report_fault,
    report_ok,
    report_warning,
)
from slam.diagnostics.sensor_checks import (
    ImageStatistics,
    check_camera,
    check_images,
    check_pair_brightness,
    check_rectification,
    check_right_repetitions,
    check_static_area,
    check_timestamps,
    measure_image,
)
from slam.errors import DataError
from slam.evaluation.trajectory_errors import path_length

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Progress = Callable[[int, int], None]

# Samples of a long dataset: runs of successive images, evenly spread. Three in a run show images that are stored twice.
_RUNS, _RUN_LENGTH = 40, 3
_STEREO_PAIRS = 8  # pairs of left and right images in which rows are compared
_DEPTH_PAIRS = 16  # images in which edges are compared with those of their depth


@dataclass
class _Samples:
    """Images that were read from a dataset for the checks.

    Attributes:
        images: statistics of all sampled left images.
        successors: those of them whose predecessor was sampled too.
        right_frozen: for each of these in a pair whether its right image equals the one before, and it does not.
        pairs: some pairs of left and right images.
        depths: measurements of the depth of all sampled images that have one.
        depth_pairs: some left images and their depth.
        masks: masks of the sampled images, which know what is static in them.
        static_ratio: static share of the last of them.
        fault: message of the first image that cannot be read; empty if there is none.
    """

    images: list[ImageStatistics] = field(default_factory=list)
    successors: list[ImageStatistics] = field(default_factory=list)
    right_frozen: list[bool] = field(default_factory=list)
    pairs: list[tuple[Image, Image]] = field(default_factory=list)
    depths: list[DepthStatistics] = field(default_factory=list)
    depth_pairs: list[tuple[Image, Depth]] = field(default_factory=list)
    masks: ImageMasks = field(default_factory=ImageMasks)
    static_ratio: float = 0.0
    fault: str = ""


def inspect_dataset(spec: DatasetSpec, progress: Progress) -> Inspection:
    """Inspect a dataset; a fault that keeps it from being opened is a finding too.

    Args:
        spec: dataset to inspect.
        progress: called with the number of images read, and of all images to read.

    Raises:
        DataError: the path is no dataset of any format.
        ConfigError: the requested format does not exist.
    """
    name = detect_format(spec)
    try:
        dataset = FORMATS[name].open_dataset(spec)
    except DataError as error:
        findings = _check_left(spec, name, str(error), progress)
    else:
        findings = _check_dataset(dataset, lambda: _open_left(spec, name), progress)
    return Inspection(str(spec.path), name, tuple(findings))


def _open_left(spec: DatasetSpec, name: str) -> Dataset:
    return FORMATS[name].open_dataset(replace(spec, left_only=True))


def _check_left(spec: DatasetSpec, name: str, trouble: str, progress: Progress) -> list[Finding]:
    """Check the left camera of a dataset whose two cameras cannot be opened together."""
    try:
        left = _open_left(spec, name)
    except DataError:
        return _check_images_alone(spec, name, trouble, progress)
    findings = _check_dataset(left, lambda: left, progress)
    return [report_fault("second camera", trouble, (Use.STEREO,)), *(f for f in findings if f.topic != "second camera")]


def _check_images_alone(spec: DatasetSpec, name: str, trouble: str, progress: Progress) -> list[Finding]:
    """Check the left images of a dataset that cannot be opened for SLAM."""
    try:
        images = open_images(replace(spec, format=name))
    except DataError as error:
        if str(error) == trouble:
            return [report_fault("opening", trouble, ALL_USES)]
        return [report_fault("opening", trouble, SLAM_USES), report_fault("images", str(error), (Use.PLACES,))]
    return [report_fault("opening", trouble, SLAM_USES), *inspect_images(images, progress)]


def inspect_images(images: ImageDataset, progress: Progress) -> list[Finding]:
    """Inspect the images of one camera, for which there may be no calibration."""
    seen = _sample(len(images), lambda index: _Sample(images[index]), progress)
    times = [] if images.timestamps is None else check_timestamps(images.timestamps)
    return [
        _check_count(len(images), "images"),
        *_check_samples(seen),
        *times,
        _check_ground_truth(images),
        *_report_remarks(images),
    ]


def inspect_opened(dataset: Dataset, progress: Progress, use: Use = Use.STEREO) -> list[Finding]:
    """Inspect a dataset that is open.

    Args:
        dataset: the dataset.
        progress: called with the number of images read, and of all images to read.
        use: the use that is intended; with one camera the pair is not looked at.
    """
    return _check_seen(dataset, _sample(len(dataset), _reader(dataset, use is not Use.STEREO), progress), use)


def _check_dataset(dataset: Dataset, open_left: Callable[[], Dataset], progress: Progress) -> list[Finding]:
    """Check a dataset for every use; a damaged right or depth image rules out the use of both cameras alone."""
    seen = _sample(len(dataset), _reader(dataset), progress)
    if not seen.fault or not (dataset.has_right or dataset.has_depth):
        return _check_seen(dataset, seen, Use.STEREO)
    left, before = open_left(), seen
    seen = _sample(len(left), _reader(left, left_only=True), progress)
    seen.pairs, seen.depths, seen.depth_pairs = before.pairs, before.depths, before.depth_pairs
    others = "right images" if dataset.has_right else "depth images"
    findings = [] if seen.fault else [report_fault(others, before.fault, (Use.STEREO,))]
    return [*findings, *_check_seen(dataset, seen, Use.STEREO)]


def _check_seen(dataset: Dataset, seen: _Samples, use: Use) -> list[Finding]:
    is_pair = dataset.has_right and use is Use.STEREO
    findings = [_check_count(len(dataset), "pairs of images" if is_pair else "images"), *_check_samples(seen)]
    findings += [*check_timestamps(dataset.timestamps), *check_camera(dataset.camera, is_pair)]
    if is_pair:
        findings += [
            check_right_repetitions(seen.right_frozen),
            check_rectification(seen.pairs),
            check_pair_brightness(seen.pairs),
        ]
    elif dataset.has_depth and use is Use.STEREO:
        findings += check_depth(seen.depths, seen.depth_pairs)
    elif use is Use.STEREO:
        findings.append(report_fault("second camera", "there are images of one camera, and no depth", (Use.STEREO,)))
    return [*findings, _check_ground_truth(dataset), *_report_remarks(dataset)]


def _report_remarks(dataset: Dataset | ImageDataset) -> list[Finding]:
    return [report_warning("reading", remark) for remark in dataset.remarks]


@dataclass(frozen=True)
class _Sample:
    """An image, and the right and the depth image that belong to it, if there are any."""

    left: Image
    right: Image | None = None
    depth: Depth | None = None


def _reader(dataset: Dataset, left_only: bool = False) -> Callable[[int], _Sample]:
    def read(index: int) -> _Sample:
        frame = dataset[index]
        return _Sample(frame.left) if left_only else _Sample(frame.left, frame.right, frame.depth)

    return read


def _sample(count: int, read: Callable[[int], _Sample], progress: Progress) -> _Samples:
    """Read images from all parts of a dataset, up to the first that cannot be read."""
    seen, indices = _Samples(), _sample_indices(count)
    compared, depth_compared = (
        set(np.linspace(0, len(indices) - 1, count).astype(int).tolist()) for count in (_STEREO_PAIRS, _DEPTH_PAIRS)
    )
    last = -1
    before: Image | None = None
    right_before: Image | None = None
    for done, index in enumerate(indices):
        try:
            sample = read(index)
        except DataError as error:
            seen.fault = str(error)
            return seen
        left, right = sample.left, sample.right
        follows = before is not None and index == last + 1
        seen.static_ratio = seen.masks.observe(left).static_ratio
        seen.images.append(measure_image(left, before if follows else None))
        if follows:
            seen.successors.append(seen.images[-1])
            if right is not None and right_before is not None:
                is_frozen = np.array_equal(right, right_before) and not seen.images[-1].is_repeated
                seen.right_frozen.append(is_frozen)
        if right is not None and done in compared:
            seen.pairs.append((left, right))
        if sample.depth is not None:
            seen.depths.append(measure_depth(sample.depth))
            if done in depth_compared:
                seen.depth_pairs.append((left, sample.depth))
        last, before, right_before = index, left, right
        progress(done + 1, len(indices))
    return seen


def _sample_indices(count: int) -> list[int]:
    """Return the indices of all images, or of runs of successive images of a long dataset."""
    if count <= _RUNS * _RUN_LENGTH:
        return list(range(count))
    first = np.linspace(0, count - _RUN_LENGTH, _RUNS).astype(int)
    return [int(index) for index in (first[:, None] + np.arange(_RUN_LENGTH)).ravel()]


def _check_samples(seen: _Samples) -> list[Finding]:
    faults = [report_fault("images", seen.fault, ALL_USES)] if seen.fault else []
    if not seen.images:
        return faults
    return [*faults, *check_images(seen.images, seen.successors), check_static_area(seen.static_ratio)]


def _check_count(count: int, things: str) -> Finding:
    if count < 2:
        forbids = SLAM_USES if count else ALL_USES  # one image has no motion, and no place to come back to
        return report_fault("count", f"{count} {things}: too few; check the folder", forbids, count=count)
    return report_ok("count", f"{count} {things}", count=count)


def _check_ground_truth(dataset: Dataset | ImageDataset) -> Finding:
    poses = dataset.ground_truth
    if poses is None:
        return report_ok("ground truth", "none: errors will not be known", metres=None)
    metres = float(path_length(poses))
    return report_ok("ground truth", f"{len(poses)} poses, {metres:.1f} m long", metres=metres)
