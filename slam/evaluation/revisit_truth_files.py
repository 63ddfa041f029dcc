"""Ground truth of revisits: a published matrix, or true poses under a declared rule."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from place_recognition.evaluation.revisit_ground_truth import RevisitRule, read_truth_matrix, truth_from_poses
from slam.errors import ConfigError, DataError
from slam.evaluation.trajectory_errors import distances_along, pair_by_time, scale_to_other
from slam.io.trajectory_reader import Trajectory, read_trajectory

MATRIX_SUFFIXES = (".mat", ".npz")


@dataclass(frozen=True)
class RevisitTruth:
    """Which earlier images show the same place as each image.

    Attributes:
        matrix: (N, N) bool, row = query, column = earlier image; None if there is no ground truth.
        origin: description of the source for people, with the rule if one was applied.
        path_lengths_m: (N,) length of the true path from the first image, metres; None if the poses are not known.
        remarks: how the file was taken and what of it was left out, a sentence each.
        tolerated: (N, N) bool, pairs that count neither as right nor as wrong; None for none. Between two recordings
            this and the matrix are (N, M), column = image of the reference.
    """

    matrix: NDArray[np.bool_] | None
    origin: str
    path_lengths_m: NDArray[np.float64] | None = None
    remarks: tuple[str, ...] = ()
    tolerated: NDArray[np.bool_] | None = None

    @property
    def required_matrix(self) -> NDArray[np.bool_]:
        """The matrix, where the caller knows that there is one."""
        assert self.matrix is not None
        return self.matrix


def read_revisit_truth(
    path: Path,
    rule: RevisitRule | None = None,
    fps: float | None = None,
    image_times: NDArray[np.float64] | None = None,
) -> RevisitTruth:
    """Read the ground truth of revisits from a matrix (.mat, .npz), or from poses (KITTI, TUM) under a rule.

    Args:
        path: file to read.
        rule: what counts as a revisit, for poses; None for the default rule.
        fps: poses per second, for a rule with a minimum time; TUM files have their own times.
        image_times: (N,) seconds, of the images, at which poses with times are interpolated; None where line i of the
            file is the pose of image i.

    Raises:
        DataError: the file is missing or damaged.
        ConfigError: the rule needs times and there are none.
    """
    if path.suffix.lower() in MATRIX_SUFFIXES:
        try:
            truth = read_truth_matrix(path)
        except ValueError as error:
            raise DataError(str(error)) from error
        return RevisitTruth(truth.matrix, str(path), remarks=truth.remarks)
    rule = rule or RevisitRule()
    trajectory = read_trajectory(path)
    images = None if image_times is None else Trajectory(image_times, np.tile(np.eye(4), (len(image_times), 1, 1)))
    trajectory = trajectory if images is None else scale_to_other(path, trajectory, images)
    times, poses, remarks = trajectory.times, trajectory.poses, trajectory.remarks
    if images is not None and times is not None:
        poses, remark = _poses_of_images(path, trajectory, images)
        times, remarks = images.times, (*remarks, remark)
    if times is None and fps is not None:
        times = np.arange(len(poses)) / fps
    if rule.min_time_gap_s > 0 and times is None:
        raise ConfigError(
            f"{path}: expected times for --min-time-gap {rule.min_time_gap_s:g}, found none;"
            " give --fps, or poses as TUM"
        )
    return replace(revisit_truth_from_poses(poses, str(path), rule, times), remarks=remarks)


def poses_of_images(path: Path, image_times: NDArray[np.float64] | None, count: int) -> Trajectory:
    """Read the true poses of a recording, one for each of `count` images with times (N,), or without.

    Raises:
        DataError: the file is missing, damaged or of another recording.
    """
    trajectory = read_trajectory(path)
    if image_times is not None and trajectory.times is not None:
        images = Trajectory(image_times, np.tile(np.eye(4), (count, 1, 1)))
        trajectory = scale_to_other(path, trajectory, images)
        poses, remark = _poses_of_images(path, trajectory, images)
        return replace(trajectory, times=image_times, poses=poses, remarks=(*trajectory.remarks, remark))
    if len(trajectory.poses) != count:
        raise DataError(
            f"{path}: expected a pose for each of {count} images, found {len(trajectory.poses)}; choose the poses of"
            " this recording"
        )
    return trajectory


def _poses_of_images(path: Path, trajectory: Trajectory, images: Trajectory) -> tuple[NDArray[np.float64], str]:
    """Return true poses (N, 4, 4) at the times of N images, each of which must have one, and how they were found."""
    pairs = pair_by_time(images, trajectory)
    if len(pairs.rows) < len(images.poses) == len(trajectory.poses):
        return trajectory.poses, f"{path}: not the times of the images, but as many poses; image i has pose i"
    if len(pairs.rows) < len(images.poses):
        raise DataError(
            f"{path}: expected true poses at the times of all {len(images.poses)} images, found"
            f" {len(pairs.rows)}; choose the truth of this recording"
        )
    return pairs.truth, f"{path}: matched by time with the {len(images.poses)} images"


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
            f" choose the truth of this recording, at the rate of its images{describe_remarks(truth)}"
        )


def describe_remarks(truth: RevisitTruth) -> str:
    """Return the remarks about a truth in brackets, for the end of a message; what was left out may be the cause."""
    return f" ({'; '.join(truth.remarks)})" if truth.remarks else ""


def describe_rule(rule: RevisitRule) -> str:
    """Describe the rule with all its numbers."""
    gap = f", {rule.min_time_gap_s:g} s apart" if rule.min_time_gap_s else ""
    pairs = "the nearest image" if rule.is_one_to_one else "all images"
    return (
        f"the rule: {pairs} within {rule.max_distance_m:g} m and {rule.max_angle_deg:g} degrees,"
        f" {rule.min_path_length_m:g} m of path{gap} between"
    )
