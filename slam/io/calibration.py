"""`calibration.toml`: the stereo camera, and the calibration error that its odometry has estimated."""

import tomllib
from dataclasses import asdict
from pathlib import Path

import numpy as np
import tomli_w
from numpy.typing import NDArray

from odometry.camera import StereoCamera
from odometry.stereo.stereo_self_calibration import NUM_COEFFICIENTS, NUM_DISTORTION, NUM_RECTIFICATION, Calibration
from slam.errors import DataError
from slam.io.files import atomic_writer

Array = NDArray[np.float64]

# Slices of the coefficients: lens distortion, then the polynomials of the rectification error along columns and rows.
_GROUPS = {
    "lens": slice(0, NUM_DISTORTION),
    "column": slice(NUM_DISTORTION, NUM_DISTORTION + NUM_RECTIFICATION),
    "row": slice(NUM_DISTORTION + NUM_RECTIFICATION, NUM_COEFFICIENTS),
}
_REMEDY = "make the run again with: revisit run SOURCE --out DIR"


def write_calibration(path: Path, calibration: Calibration) -> None:
    """Write camera and coefficients, pixels, each with its standard deviation (without their correlations).

    Raises:
        OutputError: the file cannot be written.
    """
    sigmas = np.sqrt(np.diag(calibration.covariance))
    values = {
        "camera": asdict(calibration.camera),
        "error_px": {name: calibration.coefficients[group].tolist() for name, group in _GROUPS.items()},
        "sigma_px": {name: sigmas[group].tolist() for name, group in _GROUPS.items()},
    }
    with atomic_writer(path) as file:
        file.write(tomli_w.dumps(values))


def read_calibration(path: Path) -> Calibration:
    """Read a calibration back; its coefficients count as independent.

    Raises:
        DataError: the file is missing or damaged.
    """
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
        error, sigma = (
            np.concatenate([np.array(values[kind][name], np.float64) for name in _GROUPS])
            for kind in ("error_px", "sigma_px")
        )
        camera = StereoCamera(**values["camera"])
    except OSError as problem:
        found = f"{problem.strerror}; {_REMEDY}, of a recording with two cameras"
        raise DataError(f"{path}: expected the calibration that a run has estimated, found {found}") from None
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as problem:
        raise DataError(f"{path}: expected camera, error_px and sigma_px, found {problem!r}; {_REMEDY}") from None
    _check(path, camera, error, sigma)
    return Calibration(camera, error, np.diag(np.square(sigma)))


def _check(path: Path, camera: StereoCamera, error: Array, sigma: Array) -> None:
    are_complete = len(error) == len(sigma) == NUM_COEFFICIENTS
    # The squares become variances: a standard deviation may be finite and its square not.
    if not are_complete or not np.isfinite([error, np.square(sigma)]).all():
        raise DataError(f"{path}: expected {NUM_COEFFICIENTS} finite coefficients, found others; {_REMEDY}")
    if not all(isinstance(side, int) and side > 0 for side in (camera.width, camera.height)):
        raise DataError(f"{path}: expected a width and a height in pixels, found others; {_REMEDY}")
