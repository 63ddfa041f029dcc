"""Odometry from a file: the trajectory of another program takes the place of the motions measured here.

The odometry of the system runs all the same. It gives what a trajectory lacks: the depth of the landmarks, and how
uncertain the motions are. Its motions are used for nothing else.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.motion import (
    EXTRAPOLATION_SIGMA_M,
    EXTRAPOLATION_SIGMA_RAD,
    FIRST_VARIANCE,
    Motion,
    extrapolation_covariance,
)
from odometry.stereo.stereo_self_calibration import Calibration
from slam.datasets.dataset import Dataset, Frame
from slam.datasets.time_sync import MAX_GAP_S, MAX_TIME_DIFFERENCE_S
from slam.errors import ConfigError, DataError
from slam.io.files import read_lines
from slam.io.trajectory_reader import read_trajectory
from slam.system import VisualOdometry

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_MAX_COMPARED = 100  # motions, over which the two odometries are compared
_MIN_COMPARED = 10  # fewer differences say too little about their spread
_CHI2_MEDIAN = 0.455  # of one degree of freedom
_SIGMA_COLUMNS, _MATRIX_COLUMNS = 6, 36
_MIN_MOVING_RATIO = 1e-3  # of the path of the file: a camera at rest shows no ratio of units


@dataclass(frozen=True)
class PlacedFrame:
    """Pose of a frame by a trajectory.

    Attributes:
        T_world_camera: (4, 4), metres.
        reason: why it is a guess between or beyond the poses of the file; empty where the file has it.
    """

    T_world_camera: Array
    reason: str


class FileTrajectory:
    """Poses of a trajectory file, by the times of the frames or by their numbers.

    Attributes:
        path: the file.
        remarks: what was left out or changed, a sentence each.
    """

    def __init__(self, path: Path) -> None:
        """Read KITTI or TUM poses, or EuRoC's csv.

        Raises:
            DataError: the file is missing or damaged.
        """
        found = read_trajectory(path)
        self.path, self.remarks = path, found.remarks
        self._times, self._poses = found.times, found.poses

    def check(self, timestamps: Array) -> None:
        """Check that the poses belong to frames with these times (N,), seconds.

        Raises:
            DataError: without times, the number of poses is another one; with times, none is near a frame.
        """
        if self._times is None:
            if len(self._poses) != len(timestamps):
                raise DataError(
                    f"{self.path}: expected {len(timestamps)} poses, one for each frame, found {len(self._poses)}; "
                    "export poses with times (TUM) or those of this drive"
                )
            return
        if not any(not self.place(k, float(time)).reason for k, time in enumerate(timestamps)):
            raise DataError(
                f"{self.path}: expected poses between {timestamps[0]:.2f} and {timestamps[-1]:.2f} s, when the frames "
                f"were taken, found {self._times[0]:.2f} to {self._times[-1]:.2f} s; export those of this drive"
            )

    def place(self, index: int, timestamp: float) -> PlacedFrame:
        """Pose of frame `index`, taken at a time in seconds."""
        if self._times is None:
            return PlacedFrame(self._poses[min(index, len(self._poses) - 1)], "")
        after = int(np.searchsorted(self._times, timestamp))
        nearest = min(after, len(self._times) - 1)
        if after and abs(self._times[after - 1] - timestamp) <= abs(self._times[nearest] - timestamp):
            nearest = after - 1
        if self._times[nearest] == timestamp:
            return PlacedFrame(self._poses[nearest], "")
        if 0 < after < len(self._times):
            return self._between(after, timestamp)
        if abs(self._times[nearest] - timestamp) <= MAX_TIME_DIFFERENCE_S:
            return PlacedFrame(self._poses[nearest], "")
        return PlacedFrame(self._poses[nearest], f"{self.path.name} has no pose at that time")

    def _between(self, after: int, timestamp: float) -> PlacedFrame:
        """Interpolate with constant twist between two poses."""
        assert self._times is not None
        start, end = self._times[after - 1], self._times[after]
        twist = se3.log(se3.inverse(self._poses[after - 1]) @ self._poses[after])
        T = self._poses[after - 1] @ se3.exp(twist * (timestamp - start) / (end - start))
        gap_s = float(end - start)
        is_near = min(timestamp - start, end - timestamp) <= MAX_TIME_DIFFERENCE_S
        reason = "" if gap_s <= MAX_GAP_S or is_near else f"{self.path.name} has no pose for {gap_s:.1f} s"
        return PlacedFrame(T, reason)


class MotionUncertainty(Protocol):
    """Tells the covariance of the motions of a file."""

    def covariance(self, index: int, measured: Motion, T_previous_current: Array) -> Array:
        """Covariance (6, 6) of the motion (4, 4) of frame `index`, rotation first, beside the one measured here."""
        ...

    def state(self) -> dict[str, Any]:
        """Everything that changes from frame to frame, for a checkpoint."""
        ...

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        ...


class StatedUncertainty:
    """Covariances that the user states (a MotionUncertainty).

    Attributes:
        covariances: (N, 6, 6) of each frame's motion, or (1, 6, 6) for all of them.
    """

    def __init__(self, covariances: Array) -> None:
        self.covariances = covariances

    def covariance(self, index: int, measured: Motion, T_previous_current: Array) -> Array:
        """Covariance (6, 6) of the motion of frame `index`."""
        return np.asarray(self.covariances[min(index, len(self.covariances) - 1)])

    def state(self) -> dict[str, Any]:
        """Nothing."""
        return {}

    def restore(self, state: dict[str, Any]) -> None:
        """Nothing."""


class EstimatedUncertainty:
    """Covariances estimated from the drive (a MotionUncertainty).

    A motion is as uncertain as the one measured here, plus the variance of the differences between the two over the
    latest motions. The variance is taken from the median square, so that moments in which one of the two fails do not
    count. A trajectory that equals the measured one has its covariances.
    """

    def __init__(self) -> None:
        self._differences: deque[Array] = deque(maxlen=_MAX_COMPARED)
        self._last: Array | None = None  # covariance of the last motion that was measured here

    def covariance(self, index: int, measured: Motion, T_previous_current: Array) -> Array:
        """Covariance (6, 6) of the motion (4, 4) of frame `index`, rotation first."""
        if not measured.predicted:
            self._last = measured.covariance
            self._differences.append(se3.log(se3.inverse(measured.T_previous_current) @ T_previous_current))
        own = measured.covariance if self._last is None else self._last
        if len(self._differences) < _MIN_COMPARED:
            return own
        variances = np.median(np.square(self._differences), axis=0) / _CHI2_MEDIAN
        return np.asarray(own + np.diag(variances))

    def state(self) -> dict[str, Any]:
        """The latest differences and covariance."""
        return {"differences": [difference.tolist() for difference in self._differences], "last": self._last}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._differences = deque(map(np.array, state["differences"]), maxlen=_MAX_COMPARED)
        self._last = state["last"]


class FileOdometry:
    """Motions of a trajectory file, with the depth of another odometry (a VisualOdometry).

    Frames without a pose are bridged at constant velocity between the poses around them, and flagged as predicted.
    """

    def __init__(self, trajectory: FileTrajectory, measured: VisualOdometry, uncertainty: MotionUncertainty) -> None:
        self._trajectory, self._measured, self._uncertainty = trajectory, measured, uncertainty
        self._previous: Array | None = None  # T_world_camera of the previous frame
        self._unmeasured = 0  # frames since the last one with a pose
        # Path lengths of the latest frames: by the file, and as measured here.
        self._steps_m: deque[tuple[float, float]] = deque(maxlen=_MAX_COMPARED)

    @property
    def has_metric_scale(self) -> bool:
        """Whether all frames have one unit of length: with one camera they may not, whoever measured them."""
        return self._measured.has_metric_scale

    @property
    def calibration(self) -> Calibration | None:
        """Calibration error of a pair as estimated so far."""
        return self._measured.calibration

    def track(self, frame: Frame) -> Motion:
        """Motion since the previous frame, by the file."""
        measured, placed = self._measured.track(frame), self._trajectory.place(frame.index, frame.timestamp)
        previous, self._previous = self._previous, placed.T_world_camera
        self._unmeasured = self._unmeasured + 1 if placed.reason else 0
        if previous is None:
            return Motion(np.eye(4), FIRST_VARIANCE * np.eye(6), bool(placed.reason), placed.reason)
        T_previous_current = se3.orthonormalize(se3.inverse(previous) @ placed.T_world_camera)
        if placed.reason:
            covariance = extrapolation_covariance(EXTRAPOLATION_SIGMA_RAD, EXTRAPOLATION_SIGMA_M, self._unmeasured)
            return Motion(T_previous_current, covariance, True, placed.reason)
        if not measured.predicted:
            paths = (T_previous_current, measured.T_previous_current)
            self._steps_m.append((float(np.linalg.norm(paths[0][:3, 3])), float(np.linalg.norm(paths[1][:3, 3]))))
        covariance = self._uncertainty.covariance(frame.index, self._in_unit_of_file(measured), T_previous_current)
        return Motion(T_previous_current, covariance, False, "")

    def disparity(self, left: Image, right: Image | None, pixels: Array) -> Array:
        """Disparity (N,) at pixels (N, 2), in the unit of the file where one camera has no unit of its own."""
        return self._measured.disparity(left, right, pixels) / self._unit()

    def _unit(self) -> float:
        """Length of the path by the file for a path of one as measured here; NaN where that is not known."""
        if self.has_metric_scale:
            return 1.0
        by_file, here = np.sum(self._steps_m, axis=0) if self._steps_m else (0.0, 0.0)
        return float(by_file / here) if here > _MIN_MOVING_RATIO * by_file and by_file > 0.0 else float("nan")

    def _in_unit_of_file(self, measured: Motion) -> Motion:
        unit = self._unit()
        if self.has_metric_scale or not np.isfinite(unit):
            return measured
        T, scale = measured.T_previous_current.copy(), np.diag([1.0, 1.0, 1.0, unit, unit, unit])
        T[:3, 3] *= unit
        return Motion(T, scale @ measured.covariance @ scale, measured.predicted, measured.reason)

    def array_bytes(self) -> int:
        """Memory of the odometry that measures beside the file, bytes."""
        return self._measured.array_bytes()

    def state(self) -> dict[str, Any]:
        """Everything that changes from frame to frame, for a checkpoint."""
        return {
            "measured": self._measured.state(),
            "uncertainty": self._uncertainty.state(),
            "previous": self._previous,
            "frames_unmeasured": self._unmeasured,
            "steps_m": [list(step) for step in self._steps_m],
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._measured.restore(state["measured"])
        self._uncertainty.restore(state["uncertainty"])
        self._previous, self._unmeasured = state["previous"], state["frames_unmeasured"]
        self._steps_m = deque(((a, b) for a, b in state["steps_m"]), maxlen=_MAX_COMPARED)


def read_uncertainty(value: str) -> MotionUncertainty:
    """Uncertainty of the motions of a file, as a user states it.

    Args:
        value: empty to estimate it from the drive; `SIGMA_RAD,SIGMA_M`, standard deviations of each motion; or a file
            with a line for each frame, of 6 standard deviations or of the 36 numbers of a covariance, rotation first
            (rad, m).

    Raises:
        ConfigError, DataError: the text is neither, or the file is missing or damaged.
    """
    if not value:
        return EstimatedUncertainty()
    sigmas = _two_numbers(value)
    if sigmas is not None:
        return StatedUncertainty(np.diag(np.repeat(np.square(sigmas), 3))[None])
    if not Path(value).is_file():
        raise ConfigError(
            f"--odometry-covariance: expected SIGMA_RAD,SIGMA_M (such as 0.001,0.02) or a file, found {value!r}"
        )
    return StatedUncertainty(_read_covariances(Path(value)))


def _two_numbers(value: str) -> Sequence[float] | None:
    try:
        sigmas = [float(word) for word in value.split(",")]
    except ValueError:
        return None
    return sigmas if len(sigmas) == 2 and np.isfinite(sigmas).all() and min(sigmas) > 0 else None


def _read_covariances(path: Path) -> Array:
    """Covariances (N, 6, 6) of a file with 6 standard deviations or 36 numbers a line."""
    rows: list[Array] = []
    for number, line in enumerate(read_lines(path), start=1):
        words = line.replace(",", " ").split()
        if words and not words[0].startswith("#"):
            rows.append(_covariance(f"{path}, line {number}", words))
    if not rows:
        raise DataError(f"{path}: expected a line of 6 or 36 numbers for each frame, found none; export it again")
    return np.array(rows)


def _covariance(where: str, words: list[str]) -> Array:
    try:
        values = np.array(words, np.float64)
    except ValueError:
        values = np.array([np.nan])
    if len(values) not in (_SIGMA_COLUMNS, _MATRIX_COLUMNS) or not np.isfinite(values).all():
        raise DataError(
            f"{where}: expected 6 standard deviations or the 36 numbers of a covariance, rotation first (rad, m), "
            f"found {' '.join(words)[:60]!r}; correct that line"
        )
    matrix = np.diag(values**2) if len(values) == _SIGMA_COLUMNS else values.reshape(6, 6)
    if not np.allclose(matrix, matrix.T) or np.linalg.eigvalsh(matrix)[0] <= 0:
        raise DataError(f"{where}: expected a symmetric covariance of positive variances, found another; correct it")
    return matrix


def check_odometry_file(path: Path, covariance: str, dataset: Dataset) -> tuple[str, ...]:
    """Check that a trajectory, and the covariances of its motions, belong to a dataset; remarks about the file.

    Raises:
        ConfigError, DataError: a file is missing or damaged, or of another drive.
    """
    trajectory, uncertainty = FileTrajectory(path), read_uncertainty(covariance)
    trajectory.check(dataset.timestamps)
    if isinstance(uncertainty, StatedUncertainty) and len(uncertainty.covariances) not in (1, len(dataset)):
        raise DataError(
            f"{covariance}: expected {len(dataset)} covariances, one for each frame, found "
            f"{len(uncertainty.covariances)}; export those of this drive"
        )
    return trajectory.remarks
