"""Where the truth about revisits comes from: a matrix that somebody published, or poses under a declared rule."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from place_recognition.evaluation.ground_truth import RevisitRule, load_truth, truth_from_poses
from slam.errors import ConfigError, DataError
from slam.storage.trajectory import read_trajectory

MATRICES = (".mat", ".npz")


@dataclass(frozen=True)
class KnownTruth:
    """Which images show the same place.

    Attributes:
        matrix: (N, N) bool, row = query, column = earlier image; None where it is not known.
        origin: where it is from, in words, with the rule where one was applied.
    """

    matrix: NDArray[np.bool_] | None
    origin: str

    @property
    def known(self) -> NDArray[np.bool_]:
        """The matrix of a truth that is known."""
        assert self.matrix is not None
        return self.matrix


def read_truth(path: Path, rule: RevisitRule | None = None, fps: float | None = None) -> KnownTruth:
    """Truth from a matrix file (.mat, .npz), or from poses (KITTI, TUM) under a rule.

    Args:
        path: the file.
        rule: for poses.
        fps: poses a second, for a rule with a gap; TUM files bring their own times.

    Raises:
        DataError: the file is missing or damaged.
        ConfigError: the rule asks for times and there are none.
    """
    if path.suffix in MATRICES:
        try:
            return KnownTruth(load_truth(path), str(path))
        except ValueError as error:
            raise DataError(f"{error}; choose the truth of this drive") from error
    rule = rule or RevisitRule()
    times, poses = read_trajectory(path)
    if times is None and fps is not None:
        times = np.arange(len(poses)) / fps
    if rule.min_time_gap_s > 0 and times is None:
        raise ConfigError(
            f"{path}: expected times for a gap of {rule.min_time_gap_s:g} s, found none; give --fps, or poses as TUM"
        )
    return truth_of_poses(poses, str(path), rule, times)


def truth_of_poses(
    poses: NDArray[np.float64], origin: str, rule: RevisitRule | None = None, times: NDArray[np.float64] | None = None
) -> KnownTruth:
    """Truth of poses T_world_camera (N, 4, 4), metres, under a rule.

    Args:
        poses: of the images.
        origin: where they are from.
        rule: None for the usual one.
        times: (N,) seconds, for a rule with a gap.
    """
    rule = rule or RevisitRule()
    return KnownTruth(truth_from_poses(poses, times, rule), f"{origin} under {in_words(rule)}")


def check_size(truth: KnownTruth, images: int, of: Path) -> None:
    """Raise DataError unless the truth has a row for each image of a drive."""
    if truth.matrix is not None and len(truth.matrix) != images:
        raise DataError(
            f"{truth.origin}: expected a truth of {images} images as in {of}, found {len(truth.matrix)};"
            " choose the truth of this drive"
        )


def in_words(rule: RevisitRule) -> str:
    """The rule with all its numbers."""
    gap = f", {rule.min_time_gap_s:g} s apart" if rule.min_time_gap_s else ""
    pairs = "the nearest image" if rule.is_one_to_one else "all images"
    return (
        f"the rule: {pairs} within {rule.max_distance_m:g} m and {rule.max_angle_deg:g} degrees,"
        f" {rule.min_path_length_m:g} m of way{gap} between"
    )
