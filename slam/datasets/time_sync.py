"""Times as recordings have them: their unit and order, pairs of images, and poses at the times of images."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from odometry import se3

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

MAX_PAIR_OFFSET_S = 0.005  # between the images of a pair: at 20 m/s a car drives 10 cm in that time
# Time stamps that are not in the order of receipt.
_MIN_DIFFERENT_SHARE = 0.5  # of the time stamps; with fewer, the clock is too coarse to tell images from copies
_MAX_DELAY_S = 1.0  # of a message that arrives late; stamps that go back farther may be those of a clock that was set
_MIN_REPEATED_IMAGES = 3  # whose times were there before the clock was set back
_MAX_PAUSE_S = 86400.0
MAX_TIME_DIFFERENCE_S = 0.01  # between a time and that of a pose which is taken for it without interpolation
MAX_GAP_S = 0.5  # between measured poses: across a longer gap, interpolation is no ground truth

_TICKS_PER_SECOND = {"seconds": 1.0, "milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}
_POSSIBLE_STEP_S = (9e-4, 10.0)  # median step between images or poses of one drive; trackers measure at up to 1 kHz
_USUAL_STEP_S = (1e-3, 1.0)  # a thousandfold range: among units that differ by a thousand, only one fits
# Whole numbers in such steps are milliseconds at 100 to 250 Hz or seconds of a time lapse: many of them are the former.
_UNCLEAR_STEPS = (4.0, 10.0)
_MIN_MANY_TIMES = 100
_DATES_S = (1e8, 1e10)  # clocks that count from 1970, in the years 1973 to 2286
_MIN_CLOCK_S = 1e3  # a clock that reads more, and never less, has not begun with the recording: its zeros are no times


@dataclass(frozen=True)
class OrderedTimes:
    """The rows of a list, or the images of a recording, in the order of time.

    Attributes:
        rows: (K,) indices of those that are used.
        seconds: (K,) their times, increasing.
        remarks: unit, order and what was left out, where they are not as expected.
    """

    rows: Indices
    seconds: Array
    remarks: tuple[str, ...] = ()


def order_by_time(path: Path, ticks: Array, ticks_per_second: float, lines: Sequence[int]) -> OrderedTimes:
    """Sort the rows of a list by time, without rows that have no time or that of another row.

    Args:
        path: the list, for the remarks.
        ticks: (N,) times; NaN where there is none.
        ticks_per_second: expected unit.
        lines: N line numbers, for the remarks.
    """
    unit = find_ticks_per_second(ticks, ticks_per_second)
    seconds, number = ticks / unit, np.asarray(lines)
    has_time = np.isfinite(seconds) & ~_is_unset(seconds)
    kept = np.flatnonzero(has_time)
    is_late = np.diff(seconds[kept]) < 0
    rows = kept[np.argsort(seconds[kept], kind="stable")]
    is_new = np.diff(seconds[rows], prepend=-np.inf) > 0
    remarks = (
        [] if unit == ticks_per_second else [f"{short_name(path)}: the times are read as {unit_name(unit)}"],
        describe_lines(path, number[~has_time], "without a time are left out"),
        describe_lines(path, number[kept[1:]][is_late], "with an earlier time than the line before are sorted"),
        describe_lines(path, number[np.sort(rows[~is_new])], "with the time of another line are left out"),
    )
    return OrderedTimes(rows[is_new], seconds[rows[is_new]], tuple(remark for some in remarks for remark in some))


def describe_lines(path: Path, lines: NDArray[np.int64], trouble: str) -> list[str]:
    """Return a remark about some lines of a file, with their count and the first of them; none without lines."""
    if not len(lines):
        return []
    return [f"{short_name(path)}: {len(lines)} lines {trouble}, the first is line {lines[0]}"]


def short_name(path: Path) -> str:
    """Name of a file with that of its folder: both cameras of EuRoC have a data.csv."""
    return "/".join(path.absolute().parts[-2:])


def _is_unset(seconds: Array) -> NDArray[np.bool_]:
    """Which times are zero because a clock had not been set, rather than the beginning of the recording."""
    others = seconds[np.isfinite(seconds) & (seconds != 0)]
    is_clock = len(others) > 0 and others.min() > max(_MIN_CLOCK_S, 10 * float(np.ptp(others)))
    return (seconds == 0) & is_clock


def unit_name(ticks_per_second: float) -> str:
    """Name of a unit of time."""
    return next((name for name, ticks in _TICKS_PER_SECOND.items() if ticks == ticks_per_second), "other units")


def find_ticks_per_second(ticks: Array, expected: float) -> float:
    """Return the unit of times (N,) by their step and date: the expected one unless another one fits better.

    With one camera or tracker, successive times differ by 1 ms to 10 s; a clock shows a date or begins near 0.
    """
    known = np.unique(ticks[np.isfinite(ticks) & (ticks != 0)])
    if len(known) == 0 or _shows_date(known / expected):
        return expected
    clock_unit = find_clock_unit(known)
    if clock_unit is not None or len(known) == 1:
        return clock_unit or expected
    step = float(np.median(np.diff(known)))
    if expected == 1.0 and len(known) >= _MIN_MANY_TIMES and are_unclear(known):
        return _TICKS_PER_SECOND["milliseconds"]
    if _POSSIBLE_STEP_S[0] <= step / expected <= _POSSIBLE_STEP_S[1]:
        return expected
    usual = (unit for unit in _TICKS_PER_SECOND.values() if _USUAL_STEP_S[0] <= step / unit < _USUAL_STEP_S[1])
    return next(usual, expected)


def are_unclear(ticks: Array) -> bool:
    """Whether increasing times (N,) may be seconds of a time lapse as well as milliseconds of a fast camera."""
    if len(ticks) < 2 or _shows_date(ticks):
        return False
    step = float(np.median(np.diff(ticks)))
    return _UNCLEAR_STEPS[0] <= step <= _UNCLEAR_STEPS[1] and bool((ticks == np.round(ticks)).all())


def find_clock_unit(ticks: Array) -> float | None:
    """Return the unit in which increasing times (N,) are dates with a possible step; None if they are not dates."""
    steps = np.diff(ticks)
    low, high = np.array(_POSSIBLE_STEP_S) if len(steps) else (-np.inf, np.inf)
    step = float(np.median(steps)) if len(steps) else 0.0
    units = (unit for unit in _TICKS_PER_SECOND.values() if _shows_date(ticks / unit) and low <= step / unit <= high)
    return next(units, None)


def _shows_date(seconds: Array) -> bool:
    """Whether increasing times are those of a clock that counts from 1970; one that begins at 0 soon doubles."""
    return len(seconds) > 0 and bool(_DATES_S[0] <= seconds[0] <= seconds[-1] < min(_DATES_S[1], 2 * seconds[0]))


def associate_timestamps(left: Array, right: Array, max_offset_s: float = MAX_PAIR_OFFSET_S) -> Indices:
    """Pair the left and right images that were taken together: indices (K, 2), both columns increasing.

    Two images are a pair if each is nearest in time to the other.

    Args:
        left: (N,) seconds, increasing.
        right: (M,) seconds, increasing.
        max_offset_s: largest difference in time within a pair.
    """
    if not len(left) or not len(right):
        return np.empty((0, 2), np.int64)
    nearest = _nearest(right, left)
    mutual = _nearest(left, right)[nearest] == np.arange(len(left))
    together = mutual & (np.abs(right[nearest] - left) <= max_offset_s)
    return np.stack([np.flatnonzero(together), nearest[together]], axis=1)


def associate_with_nearest(times: Array, queries: Array, max_offset_s: float) -> Indices:
    """Give each query the nearest of some times: indices (K, 2) of query and time, both columns without a decrease.

    Unlike in `associate_timestamps`, one time may be that of several queries: two free-running cameras of one rate have
    a stretch, again and again, where each image lies between two of the other camera.

    Args:
        times: (N,) seconds, increasing.
        queries: (M,) seconds, increasing.
        max_offset_s: largest difference; queries without a time as near as that are left out.
    """
    if not len(times) or not len(queries):
        return np.empty((0, 2), np.int64)
    nearest = _nearest(times, queries)
    is_near = np.abs(times[nearest] - queries) <= max_offset_s
    return np.stack([np.flatnonzero(is_near), nearest[is_near]], axis=1)


def _nearest(times: Array, queries: Array) -> Indices:
    """Index of the time nearest to each query; of two equally near ones, the earlier."""
    after = np.clip(np.searchsorted(times, queries), 1, max(len(times) - 1, 1))
    after = np.minimum(after, len(times) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(queries - times[before] <= times[after] - queries, before, after)


@dataclass(frozen=True)
class InterpolatedTrajectory:
    """Ground-truth poses at the times of images.

    Attributes:
        frames: range of the images that have a pose: those between the first and the last measured pose.
        poses: T_world_camera (N, 4, 4) of these images, metres; world is the first pose. None where unknown.
        remark: which images were left out, or why the poses are unknown; empty otherwise.
    """

    frames: slice
    poses: Array | None
    remark: str = ""


def interpolate_poses(times: Array, pose_times: Array, poses: Array) -> InterpolatedTrajectory:
    """Interpolate measured poses at the times of images: positions linearly, rotations by slerp.

    Images before the first and after the last measured pose are left out, so that every image has ground truth.
    If the measurement paused for longer than MAX_GAP_S while images were taken, no poses are returned.

    Args:
        times: (N,) of the images, seconds, increasing.
        pose_times: (M,) of the measured poses, seconds, increasing.
        poses: measured T_world_camera (M, 4, 4), metres.
    """
    everything = slice(0, len(times))
    if len(pose_times) < 2:
        return InterpolatedTrajectory(everything, None, "the ground truth has fewer than two poses and is not used")
    first, last = np.searchsorted(times, pose_times[0]), np.searchsorted(times, pose_times[-1], side="right")
    if last - first < 2:
        return InterpolatedTrajectory(everything, None, "the ground truth is of another time and not used")
    frames = slice(int(first), int(last))
    gaps = (np.diff(pose_times) > MAX_GAP_S) & (pose_times[:-1] < times[last - 1]) & (pose_times[1:] > times[first])
    if gaps.any():
        at_s, length_s = float(pose_times[:-1][gaps][0] - times[0]), float(np.diff(pose_times)[gaps][0])
        remark = f"the ground truth pauses for {length_s:.1f} s after {at_s:.1f} s and is not used"
        return InterpolatedTrajectory(everything, None, remark)
    T_world_camera = _interpolate(times[frames], pose_times, poses)
    left_out = len(times) - (frames.stop - frames.start)
    remark = f"{left_out} images before or after the ground truth are left out" if left_out else ""
    return InterpolatedTrajectory(frames, se3.inverse(T_world_camera[0]) @ T_world_camera, remark)


def _interpolate(times: Array, pose_times: Array, poses: Array) -> Array:
    out = np.repeat(np.eye(4)[None], len(times), axis=0)
    out[:, :3, :3] = Slerp(pose_times, Rotation.from_matrix(poses[:, :3, :3]))(times).as_matrix()
    out[:, :3, 3] = np.stack([np.interp(times, pose_times, axis) for axis in poses[:, :3, 3].T], axis=1)
    return out


def order_timestamps(stamps: Array, received: Array) -> OrderedTimes:
    """Put images into the order of their time stamps; leave copies and images without a time stamp out.

    Where the stamps tell no order, because all are missing, most are equal, or the clock was set back so that two parts
    of the recording have the same times, the times of receipt are used.

    Args:
        stamps: (N,) seconds, in the order of receipt; 0 or less where there is none.
        received: (N,) times of receipt, seconds.
    """
    indices = np.flatnonzero(stamps > 0)
    reason = _reason_against(stamps[indices])
    if reason:
        return _sorted_out(np.arange(len(stamps)), received, (f"{reason}: the times of receipt are used",))
    missing = np.flatnonzero(stamps <= 0)
    remarks = _count_remark(missing, "without a time stamp left out")
    return _sorted_out(indices, stamps[indices], remarks)


def _reason_against(stamps: Array) -> str:
    """Why time stamps cannot be used; empty if they can."""
    if not len(stamps):
        return "the images have no time stamps"
    if len(np.unique(stamps)) < _MIN_DIFFERENT_SHARE * len(stamps):
        return f"only {len(np.unique(stamps))} of {len(stamps)} time stamps are different"
    back = np.flatnonzero(np.diff(stamps) < 0) + 1
    if len(back) == 1:
        at = int(back[0])
        overlap = int((stamps[at:] > stamps[0]).sum())
        if stamps[at - 1] - stamps[at] > _MAX_DELAY_S and overlap >= _MIN_REPEATED_IMAGES:
            return f"the time stamps are set back by {stamps[at - 1] - stamps[at]:.1f} s at image {at}"
    return ""


def _sorted_out(indices: Indices, times: Array, remarks: tuple[str, ...]) -> OrderedTimes:
    """Sort images by time, and leave copies and those of another epoch out."""
    late = indices[times < np.maximum.accumulate(times)]
    order = np.argsort(times, kind="stable")
    indices, times = indices[order], times[order]
    is_new = np.diff(times, prepend=-np.inf) > 0
    is_near = _is_of_largest_group(times)
    copies, far = indices[~is_new], indices[is_new & ~is_near]
    remarks = (
        *remarks,
        *_count_remark(late, "later than the time stamps say and sorted"),
        *_count_remark(np.sort(copies), "with the time stamp of another left out as copies"),
        *_count_remark(np.sort(far), "days away from the others by the time stamps left out"),
    )
    return OrderedTimes(indices[is_new & is_near], times[is_new & is_near], remarks)


def _is_of_largest_group(times: Array) -> NDArray[np.bool_]:
    """Mask (N,) of the largest group of sorted times without a gap of a day: a clock may be set after the start."""
    groups = np.cumsum(np.diff(times, prepend=times[:1]) > _MAX_PAUSE_S)
    return np.asarray(groups == np.argmax(np.bincount(groups)))


def _count_remark(indices: Indices, words: str) -> tuple[str, ...]:
    return (f"images {words}: {len(indices)}, the first is image {indices[0]}",) if len(indices) else ()
