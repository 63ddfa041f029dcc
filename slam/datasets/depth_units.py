"""The units of depth images: from stored values to metres, and whether the result can be.

What a depth camera writes is metres times a scale: 5000 in TUM RGB-D (Sturm et al., IROS 2012), 1000 in ROS (REP 118)
and almost everywhere else, 1 in floats.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam.datasets.camera_toml import CAMERA_TOML

Depth = NDArray[np.float32]

MILLIMETRES, TUM_UNITS = 1000.0, 5000.0  # units per metre
# What else is found: metres, centimetres, tenths of a millimetre, KITTI's depth, Intel's L515.
_KNOWN_SCALES = (MILLIMETRES, TUM_UNITS, 1.0, 100.0, 10000.0, 256.0, 4000.0)
_POSSIBLE_MEDIAN_M = (0.01, 100.0)  # of all depths of an image: no depth camera measures nearer or farther
_USUAL_MEDIAN_M = (0.3, 10.0)
_SATURATED = 65535  # value of 16 bits beyond the range: no measurement


def usual_scale(values: NDArray[Any] | None) -> float:
    """Units per metre that values of a type usually have: whole numbers are millimetres, floats metres."""
    return 1.0 if values is not None and values.dtype.kind == "f" else MILLIMETRES


def to_metres(values: NDArray[Any], units_per_m: float) -> Depth:
    """Convert stored values (H, W) to depth (H, W), metres; NaN where there is no measurement.

    Args:
        values: whole numbers of at least 16 bits, or floats; 0 and the largest of 16 bits stand for no measurement.
        units_per_m: scale of the values.

    Raises:
        ValueError: the values are those of another kind of image.
    """
    if values.ndim != 2:
        raise ValueError("expected one depth in each pixel, found a colour image; are colour and depth swapped?")
    if values.dtype.kind not in "uif" or (values.dtype.kind != "f" and values.dtype.itemsize < 2):
        raise ValueError(
            f"expected depth of 16 bits or floats, found {values.dtype}; give the depth itself, not a picture of it"
        )
    with np.errstate(over="ignore", invalid="ignore"):  # of values that are no measurements
        depth = values.astype(np.float32) / np.float32(units_per_m)
        is_measured = (depth > 0) & np.isfinite(depth)
    if values.dtype == np.uint16:
        is_measured &= values != _SATURATED
    depth[~is_measured] = np.nan
    return depth


def median_depth(depth: Depth) -> float:
    """Median of a depth image (H, W), metres; NaN without a measurement. Every fourth pixel and row is enough."""
    some = depth[::4, ::4]
    some = some[np.isfinite(some)]
    return float(np.median(some)) if len(some) else float("nan")


def is_possible_median(median_m: float) -> bool:
    """Whether the median depth of a recording, metres, can be one of a depth camera."""
    return _POSSIBLE_MEDIAN_M[0] <= median_m <= _POSSIBLE_MEDIAN_M[1]


def describe_scale(median_m: float, units_per_m: float) -> str:
    """What is wrong with a scale, by the median depth in metres, and the likely remedy; empty if it is possible."""
    low, high = _POSSIBLE_MEDIAN_M
    if is_possible_median(median_m):
        return ""
    found = f"above {high:g}" if median_m > high else f"below {low:g}"
    usual = (s for s in _KNOWN_SCALES if _USUAL_MEDIAN_M[0] <= median_m * units_per_m / s <= _USUAL_MEDIAN_M[1])
    likely = next(usual, None)
    remedy = "depth_scale" if likely is None else f"depth_scale = {likely:g}"
    return (
        f"the median depth is {found} m ({median_m:.3g} m); give {remedy} in {CAMERA_TOML}, now it is {units_per_m:g}"
    )
