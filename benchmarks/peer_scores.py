"""Scores of the programs that `peers.py` compares: one scorer, Revisit's own evaluation, for all of them."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from slam.errors import DataError
from slam.evaluation.loops import is_same_place
from slam.evaluation.trajectory_errors import (
    SegmentRule,
    absolute_trajectory_error,
    end_error,
    kitti_errors,
    path_length,
)
from slam.io.files import read_text

Array = NDArray[np.float64]
Scores = dict[str, float | None]

# The table of a drive with true poses: ATE of the trajectory before and after loop closing, ATE of the last of the two
# after scaling, and the drift before loop closing.
TRUTH_COLUMNS = ("ATE m", "closed m", "Sim(3) m", "t_rel %", "r_rel deg", "end %")
PAIR_COLUMNS = ("pairs m", "closed m", "pairs deg", "closed deg")
LOOP_COLUMNS = ("loops", "true", "false")
COST_COLUMNS = ("ms", "cpu ms", "MB")

_SHORT_DRIVE_M = 100.0  # a drive that is shorter has none of KITTI's segments
_SHORT_SEGMENTS = SegmentRule(tuple(np.arange(10.0, 90.0, 10.0)), 1)


@dataclass(frozen=True)
class Loops:
    """Loops that a program closed.

    Attributes:
        count: their number; None for a program that closes none or does not say.
        true, false: number of true and false ones by the true poses; None where they are not known.
    """

    count: int | None = None
    true: int | None = None
    false: int | None = None


@dataclass(frozen=True)
class Estimate:
    """What a program found on a drive.

    Attributes:
        odometry: T_world_camera (N, 4, 4), metres, before loop closing.
        corrected: the same after loop closing; None for a program without.
        loops: its loops.
        milliseconds: wall-clock time of a frame by the program's own clock; None for a program without one.
        remark: what a reader of the table must know; empty for nothing.
    """

    odometry: Array
    corrected: Array | None = None
    loops: Loops = Loops()
    milliseconds: float | None = None
    remark: str = ""

    @property
    def final(self) -> Array:
        """The last trajectory of the program."""
        return self.odometry if self.corrected is None else self.corrected


@dataclass(frozen=True)
class MeasuredPair:
    """A relative pose of two frames that was measured by other means than a trajectory.

    Attributes:
        a, b: indices of the frames.
        position_m: (3,) position of the left camera b in the left camera a, metres.
        rotation_deg: angle between the two, degrees.
    """

    a: int
    b: int
    position_m: Array
    rotation_deg: float


def segment_rule(length_m: float) -> SegmentRule:
    """Return KITTI's rule, and for drives shorter than 100 m segments of 10 to 80 m from every frame."""
    return SegmentRule() if length_m >= _SHORT_DRIVE_M else _SHORT_SEGMENTS


def score_poses(estimate: Estimate, truth: Array) -> Scores:
    """Compare an estimate with true poses T_world_camera (N, 4, 4), metres. Keys: `TRUTH_COLUMNS`."""
    length_m, corrected = path_length(truth), estimate.corrected
    segments = kitti_errors(estimate.odometry, truth, segment_rule(length_m))
    return {
        "ATE m": absolute_trajectory_error(estimate.odometry, truth),
        "closed m": None if corrected is None else absolute_trajectory_error(corrected, truth),
        "Sim(3) m": absolute_trajectory_error(estimate.final, truth, "sim3"),
        "t_rel %": None if segments is None else segments.t_rel_percent,
        "r_rel deg": None if segments is None else segments.r_rel_deg_per_100m,
        "end %": None if length_m == 0 else 100 * end_error(estimate.odometry, truth) / length_m,
    }


def score_pairs(estimate: Estimate, pairs: Sequence[MeasuredPair]) -> Scores:
    """Compare an estimate with measured relative poses. Keys: `PAIR_COLUMNS`; each value is a mean over the pairs."""
    before = _pair_errors(estimate.odometry, pairs)
    after = (None, None) if estimate.corrected is None else _pair_errors(estimate.corrected, pairs)
    return dict(zip(PAIR_COLUMNS, (before[0], after[0], before[1], after[1]), strict=True))


def _pair_errors(poses: Array, pairs: Sequence[MeasuredPair]) -> tuple[float, float]:
    """Return the mean errors of position, metres, and of the angle, degrees."""
    T_a_b = [se3.inverse(poses[pair.a]) @ poses[pair.b] for pair in pairs]
    position = [float(np.linalg.norm(T[:3, 3] - pair.position_m)) for T, pair in zip(T_a_b, pairs, strict=True)]
    angle = [abs(np.degrees(se3.angle(T)) - pair.rotation_deg) for T, pair in zip(T_a_b, pairs, strict=True)]
    return float(np.mean(position)), float(np.mean(angle))


def count_loops(pairs: Sequence[tuple[int, int]], truth: Array | None) -> Loops:
    """Count the loops (query, match) of a program that are at one place by true poses (N, 4, 4), metres."""
    if truth is None:
        return Loops(len(pairs))
    true = sum(is_same_place(truth, query, match) for query, match in pairs)
    return Loops(len(pairs), true, len(pairs) - true)


def read_pairs(path: Path) -> list[MeasuredPair]:
    """Read measured relative poses: a table with the columns a, b, x, y, z and rotation_deg; # begins a comment.

    Raises:
        DataError: the file has no such table.
    """
    lines = [line for line in read_text(path).splitlines() if not line.startswith("#")]
    try:
        return [_pair(row) for row in csv.DictReader(lines)]
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(
            f"{path}: expected numbers in the columns a, b, x, y, z and rotation_deg, found {error}; correct the table"
        ) from None


def _pair(row: dict[str, str]) -> MeasuredPair:
    position = np.array([float(row[axis]) for axis in "xyz"])
    return MeasuredPair(int(row["a"]), int(row["b"]), position, float(row["rotation_deg"]))


def describe_spread(values: Sequence[float | None], digits: int) -> str:
    """Return the median of several runs, with half of the range unless it rounds to 0; "-" if any is unknown."""
    known = [value for value in values if value is not None]
    if not known or len(known) < len(values):
        return "-"
    spread = f"{np.ptp(known) / 2:.{digits}f}"
    return f"{np.median(known):.{digits}f}" + (f" ±{spread}" if float(spread) else "")
