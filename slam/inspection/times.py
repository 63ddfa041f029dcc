"""Checks of timestamps: frame rate and pauses."""

import numpy as np
from numpy.typing import NDArray

from slam.inspection.finding import Finding, report_ok, report_warning

Array = NDArray[np.float64]

_PAUSE_RATIO = 3.0  # a pause is a step longer than this many median steps
_MIN_RATE_HZ = 4.0  # at less, successive images from a car have too little in common


def check_timestamps(times: Array) -> list[Finding]:
    """Check the rate and the pauses of times (N,), seconds, increasing."""
    if len(times) < 2:
        return []
    steps = np.diff(times)
    median_s = float(np.median(steps))
    return [_check_rate(times, median_s), _check_pauses(steps, median_s, times)]


def _check_rate(times: Array, median_s: float) -> Finding:
    seconds = float(times[-1] - times[0])
    text = f"{1 / median_s:.1f} images a second, {seconds:.1f} s in all"
    figures = {"rate_hz": 1 / median_s, "seconds": seconds}
    if 1 / median_s < _MIN_RATE_HZ:
        return report_warning("rate", f"{text}: slow; successive images must still show the same things", **figures)
    return report_ok("rate", text, **figures)


def _check_pauses(steps: Array, median_s: float, times: Array) -> Finding:
    pauses = np.flatnonzero(steps > _PAUSE_RATIO * median_s)
    if not len(pauses):
        return report_ok("pauses", f"none: no step above {steps.max():.3f} s", pauses=0, longest_s=float(steps.max()))
    longest = int(pauses[np.argmax(steps[pauses])])
    return report_warning(
        "pauses",
        f"{len(pauses)}, the longest of {steps[longest]:.2f} s after image {longest}; motion is guessed across them",
        pauses=len(pauses),
        longest_s=float(steps[longest]),
        after_s=float(times[longest] - times[0]),
    )
