"""Were the images taken in time?"""

import numpy as np
from numpy.typing import NDArray

from slam.inspection.finding import Finding, doubtful, good

Array = NDArray[np.float64]

_PAUSE = 3.0  # times the usual step between images
_SLOW = 4.0  # images a second: at less, a car has driven on too far


def judge_times(times: Array) -> list[Finding]:
    """Judge times (N,), seconds, increasing."""
    if len(times) < 2:
        return []
    steps = np.diff(times)
    usual = float(np.median(steps))
    return [_rate(times, usual), _pauses(steps, usual, times)]


def _rate(times: Array, usual: float) -> Finding:
    seconds = float(times[-1] - times[0])
    text = f"{1 / usual:.1f} images a second, {seconds:.1f} s in all"
    figures = {"rate_hz": 1 / usual, "seconds": seconds}
    if 1 / usual < _SLOW:
        return doubtful("rate", f"{text}: slow; successive images must still show the same things", **figures)
    return good("rate", text, **figures)


def _pauses(steps: Array, usual: float, times: Array) -> Finding:
    pauses = np.flatnonzero(steps > _PAUSE * usual)
    if not len(pauses):
        return good("pauses", f"none: no step above {steps.max():.3f} s", pauses=0, longest_s=float(steps.max()))
    longest = int(pauses[np.argmax(steps[pauses])])
    return doubtful(
        "pauses",
        f"{len(pauses)}, the longest of {steps[longest]:.2f} s after image {longest}; motion is guessed across them",
        pauses=len(pauses),
        longest_s=float(steps[longest]),
        after_s=float(times[longest] - times[0]),
    )
