"""Ground truth of revisits: a published matrix, or true poses under a declared rule."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from place_recognition.evaluation.revisit_ground_truth import RevisitRule, load_truth, truth_from_poses
from slam.errors import ConfigError, DataError
from slam.evaluation.trajectory_errors import distances_along
from slam.io.trajectory_files import read_trajectory

MATRIX_SUFFIXES = (".mat", ".npz")


@dataclass(frozen=True)
class RevisitTruth:
    """Which earlier images show the same place as each image.

    Attributes:
        matrix: (N, N) bool, row = query, column = earlier image; None if there is no ground truth.
        origin: description of the source for people, with the rule if one was applied.
        path_lengths_m: (N,) length of the true path from the first image, metres; None if the poses are not known.
    """

    matrix: NDArray[np.bool_] | None
    origin: str
    path_lengths_m: NDArray[np.float64] | None = None

    @property
    def required_matrix(self) -> NDArray[np.bool_]:
        """The matrix, where the caller knows that there is one."""
        assert self.matrix is not None
        return self.matrix


def read_revisit_truth(path: Path, rule: RevisitRule | None = None, fps: float | None = None) -> RevisitTruth:
    """Read the ground truth of revisits from a matrix (.mat, .npz), or from poses (KITTI, TUM) under a rule.

    Args:
        path: file to read.
        rule: what counts as a revisit, for poses; None for the default rule.
        fps: poses per second, for a rule with a minimum time; TUM files have their own times.

    Raises:
        DataError: the file is missing or damaged.
        ConfigError: the rule needs times and there are none.
    """
    if path.suffix in MATRIX_SUFFIXES:
        try:
            return RevisitTruth(load_truth(path), str(path))
        except ValueError as error:
            raise DataError(f"{error}; choose the truth of this recording") from error
    rule = rule or RevisitRule()
    times, poses = read_trajectory(path)
    if times is None and fps is not None:
        times = np.arange(len(poses)) / fps
    if rule.min_time_gap_s > 0 and times is None:
        raise ConfigError(
            f"{path}: expected times for --min-time-gap {rule.min_time_gap_s:g}, found none;"
            " give --fps, or poses as TUM"
        )
    return revisit_truth_from_poses(poses, str(path), rule, times)


def revisit_truth_from_poses(
    poses: NDArray[np.float64], origin: str, rule: RevisitRule | None = None, times: NDArray[np.float64] | None = None
) -> RevisitTruth:
    """Compute the ground truth of revisits from poses T_world_camera (N, 4, 4), metres, under a rule.

    Args:
        poses: true poses of the images.
        origin: description of their source for people.
        rule: what counts as a revisit; None for the default rule.
        times: (N,) seconds, for a rule with a minimum time.
    """
    rule = rule or RevisitRule()
    matrix = truth_from_poses(poses, times, rule)
    return RevisitTruth(matrix, f"{origin} under {describe_rule(rule)}", distances_along(poses))


def check_truth_size(truth: RevisitTruth, images: int, of: Path) -> None:
    """Raise DataError unless the ground truth has a row for each image of a recording."""
    if truth.matrix is not None and len(truth.matrix) != images:
        raise DataError(
            f"{truth.origin}: expected a truth of {images} images as in {of}, found {len(truth.matrix)};"
            " choose the truth of this recording"
        )


def describe_rule(rule: RevisitRule) -> str:
    """Describe the rule with all its numbers."""
    gap = f", {rule.min_time_gap_s:g} s apart" if rule.min_time_gap_s else ""
    pairs = "the nearest image" if rule.is_one_to_one else "all images"
    return (
        f"the rule: {pairs} within {rule.max_distance_m:g} m and {rule.max_angle_deg:g} degrees,"
        f" {rule.min_path_length_m:g} m of path{gap} between"
    )
