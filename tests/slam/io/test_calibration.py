"""What was learned of the calibration comes back from its file."""

from pathlib import Path

import numpy as np
import pytest

from odometry.camera import StereoCamera
from odometry.stereo.stereo_self_calibration import NUM_COEFFICIENTS, Calibration, CalibrationConfig
from slam.errors import DataError
from slam.io.calibration import read_calibration, write_calibration

CAMERA = StereoCamera(718.856, 718.1, 607.19, 185.22, 0.54, 1241, 376)


def learned() -> Calibration:
    return Calibration(
        CAMERA,
        np.linspace(-3, 2, NUM_COEFFICIENTS) / 3,
        CalibrationConfig().prior(CAMERA),
    )


def test_what_is_written_is_read_bit_by_bit(tmp_path: Path) -> None:
    write_calibration(tmp_path / "calibration.toml", learned())
    back = read_calibration(tmp_path / "calibration.toml")
    assert back.camera == CAMERA
    np.testing.assert_array_equal(back.coefficients, learned().coefficients)
    np.testing.assert_allclose(back.covariance, learned().covariance, rtol=1e-14)


@pytest.mark.parametrize("text", ["", "[camera", "[camera]\nfx = 1.0\n", "[error_px]\nlens = [1.0]\n"])
def test_a_damaged_file_is_named_with_what_was_expected(tmp_path: Path, text: str) -> None:
    path = tmp_path / "calibration.toml"
    path.write_text(text)
    with pytest.raises(DataError, match=r"calibration.toml: expected camera, error_px and sigma_px"):
        read_calibration(path)


def test_too_few_coefficients_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "calibration.toml"
    write_calibration(path, learned())
    path.write_text(path.read_text().replace(f"{float(learned().coefficients[0])!r},", "", 1))
    with pytest.raises(DataError, match="expected 15 finite coefficients"):
        read_calibration(path)


def test_a_missing_calibration_is_an_error_with_a_remedy(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="of a recording with two cameras"):
        read_calibration(tmp_path / "calibration.toml")
