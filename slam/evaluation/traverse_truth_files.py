"""Ground truth of two recordings: equal numbers, a matrix, true poses of both, or positions in the names of files."""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from place_recognition.evaluation.revisit_ground_truth import RevisitRule
from place_recognition.evaluation.traverse_ground_truth import (
    TraverseTruth,
    read_traverse_truth,
    truth_of_equal_numbers,
    truth_of_poses,
    truth_of_positions,
)
from slam.datasets.formats.image_sequence import ImageSequence
from slam.datasets.formats.recording import ImageDataset
from slam.errors import ConfigError, DataError
from slam.evaluation.revisit_truth_files import MATRIX_SUFFIXES, RevisitTruth, poses_of_images
from slam.evaluation.trajectory_errors import distances_along

# Of positions in the names of files: the rule of Pitts30k, MSLS and the other sets that have them.
_NAMED_DISTANCE_M = 25.0


@dataclass(frozen=True)
class TraverseTruthOptions:
    """How the ground truth of two recordings is found; the names are those of the command line.

    Attributes:
        ground_truth: matrix of both recordings, or poses of the query; None where there is neither.
        reference_truth: poses of the reference, in the frame of the query's; None where there are none.
        tolerance: largest difference of the numbers of two images of one place; None where numbers say nothing.
        max_distance_m: largest distance of two images of one place; None for the default of the kind of truth.
        soft: largest difference of numbers, or distance in metres, of a pair that counts neither as right nor as wrong.
    """

    ground_truth: Path | None = None
    reference_truth: Path | None = None
    tolerance: int | None = None
    max_distance_m: float | None = None
    soft: float | None = None

    def check(self) -> None:
        """Raise ConfigError for numbers out of range, and for options that exclude each other."""
        if self.tolerance is not None and self.ground_truth is not None:
            raise ConfigError(
                "--tolerance: equal numbers are the ground truth; leave out --ground-truth or this option"
            )
        if self.reference_truth is not None and self.ground_truth is None:
            raise ConfigError("--reference-truth: expected the poses of the query too; give --ground-truth")
        if self.tolerance is not None and self.tolerance < 0:
            raise ConfigError(f"--tolerance: expected a number of images from 0, found {self.tolerance}")
        if self.max_distance_m is not None and not 0 < self.max_distance_m < math.inf:
            raise ConfigError(f"--max-distance: expected metres above 0, found {self.max_distance_m:g}")
        if self.soft is not None and not 0 < self.soft < math.inf:
            raise ConfigError(f"--soft: expected a number above 0, found {self.soft:g}")
        if self.soft is not None and self.soft < max(self.tolerance or 0, self.max_distance_m or 0.0):
            raise ConfigError(
                f"--soft: expected at least what must be found, found {self.soft:g}; give a larger number"
            )


def resolve_traverse_truth(options: TraverseTruthOptions, query: ImageDataset, reference: ImageDataset) -> RevisitTruth:
    """Return the ground truth of two recordings by the options, else by the names of their files, else none.

    Raises:
        DataError: a file is missing, damaged or of other recordings.
        ConfigError: the options do not fit the recordings.
    """
    if options.tolerance is not None:
        return _by_numbers(options, options.tolerance, query, reference)
    if options.ground_truth is not None:
        if options.ground_truth.suffix.lower() in MATRIX_SUFFIXES:
            return _by_matrix(options, options.ground_truth, query, reference)
        return _by_poses(options, options.ground_truth, query, reference)
    if _has_positions(query) and _has_positions(reference):
        return _by_names(options, query, reference)
    remark = "no ground truth; give --tolerance N if images of one number show one place"
    return RevisitTruth(None, "none", remarks=(remark,) if len(query) == len(reference) else ())


def _by_numbers(
    options: TraverseTruthOptions, tolerance: int, query: ImageDataset, reference: ImageDataset
) -> RevisitTruth:
    if len(query) != len(reference):
        raise ConfigError(
            f"--tolerance: expected as many query as reference images, found {len(query)} and {len(reference)}; give"
            " a matrix or poses with --ground-truth"
        )
    soft = None if options.soft is None else int(options.soft)
    found = truth_of_equal_numbers(len(query), tolerance, soft)
    return _revisit_truth(found, f"equal numbers, +-{tolerance}", options)


def _by_matrix(options: TraverseTruthOptions, path: Path, query: ImageDataset, reference: ImageDataset) -> RevisitTruth:
    if options.soft is not None:
        raise ConfigError("--soft: a matrix states what is tolerated itself, as `soft`; leave this option out")
    return _revisit_truth(read_matrix(path, (len(query), len(reference))), str(path), options)


def read_matrix(path: Path, shape: tuple[int, int]) -> TraverseTruth:
    """Read the truth of N queries and M reference images, shape (N, M), from a .npz or .mat file.

    Raises:
        DataError: the file is missing, damaged, or of other recordings.
    """
    try:
        return read_traverse_truth(path, shape)
    except ValueError as error:
        raise DataError(str(error)) from error


def _by_poses(options: TraverseTruthOptions, path: Path, query: ImageDataset, reference: ImageDataset) -> RevisitTruth:
    if options.reference_truth is None:
        raise ConfigError(
            f"{path}: expected a matrix (.mat, .npz), or the poses of the reference too; give --reference-truth"
        )
    ours = poses_of_images(path, query.timestamps, len(query))
    theirs = poses_of_images(options.reference_truth, reference.timestamps, len(reference))
    rule = RevisitRule()
    distance = rule.max_distance_m if options.max_distance_m is None else options.max_distance_m
    found = truth_of_poses(ours.poses, theirs.poses, distance, rule.max_angle_deg, options.soft)
    origin = f"{path} and {options.reference_truth} within {distance:g} m and {rule.max_angle_deg:g} degrees"
    truth = _revisit_truth(found, origin, options)
    return replace(truth, path_lengths_m=distances_along(ours.poses), remarks=(*ours.remarks, *theirs.remarks))


def _by_names(options: TraverseTruthOptions, query: ImageDataset, reference: ImageDataset) -> RevisitTruth:
    distance = _NAMED_DISTANCE_M if options.max_distance_m is None else options.max_distance_m
    ours, theirs = positions_from_names(query), positions_from_names(reference)
    found = truth_of_positions(ours, theirs, distance, options.soft)
    return _revisit_truth(found, f"positions in the names of the files within {distance:g} m", options)


def _revisit_truth(found: TraverseTruth, origin: str, options: TraverseTruthOptions) -> RevisitTruth:
    soft = "" if options.soft is None else f", tolerated to {options.soft:g}"
    return RevisitTruth(found.hard, origin + soft, remarks=found.remarks, tolerated=found.tolerated)


def _has_positions(images: ImageDataset) -> bool:
    return isinstance(images, ImageSequence) and images.files[0].name.startswith("@")


def positions_from_names(images: ImageDataset) -> NDArray[np.float64]:
    """Read the positions (N, 2), east and north in metres, from names such as `@0584321.21@4477123.52@17@T@....jpg`.

    Raises:
        DataError: a name has no position, or the positions are of several zones of the UTM grid.
    """
    assert isinstance(images, ImageSequence)
    positions: list[list[float]] = []
    zones: dict[str, Path] = {}
    for file in images.files:
        parts = [part.strip() for part in file.name.split("@")]
        try:
            position = [float(part) for part in parts[1:3]]
        except ValueError:
            position = []
        if parts[0] or len(position) < 2 or not np.isfinite(position).all():
            raise DataError(
                f"{file}: expected a name that begins with @east@north@, metres, as the others', found another; rename"
                " or remove it"
            )
        positions.append(position)
        if len(parts) > 3 and parts[3].isdigit():
            zones.setdefault(parts[3], file)
    if len(zones) > 1:
        (first, _), (second, file) = list(zones.items())[:2]
        raise DataError(
            f"{file}: expected all images in one UTM zone, found zones {first} and {second}; split the set by zone"
        )
    return np.array(positions, np.float64)
