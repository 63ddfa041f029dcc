"""Depth of whole images: of scenes whose depth is known, through cameras whose error is known."""

import cv2
import numpy as np
import pytest

from odometry.camera import StereoCamera
from odometry.stereo.stereo_self_calibration import NUM_COEFFICIENTS, NUM_DISTORTION, Calibration, CalibrationConfig
from slam.mapping.dense_stereo import DenseStereo, downscale_camera

from .scenes import CAMERA, photographed, rays

KITTI = StereoCamera(718.856, 718.856, 607.19, 185.22, 0.54, 1241, 376)


def perfect(camera: StereoCamera) -> Calibration:
    return Calibration.unknown(camera, CalibrationConfig())


@pytest.mark.parametrize(("camera", "disparity"), [(CAMERA, 12.0), (CAMERA, 20.5), (KITTI, 41.0)])
def test_a_wall_is_where_its_disparity_says_at_any_size_of_image(camera: StereoCamera, disparity: float) -> None:
    left, right = photographed(camera, disparity, np.random.default_rng(0))
    depth = DenseStereo(perfect(camera), 25.0).compute_depth(left, right).depth
    known = depth[depth > 0]
    assert len(known) > 0.8 * depth.size
    assert np.median(known) == pytest.approx(camera.fx * camera.baseline / disparity, rel=0.01)


def test_what_is_too_far_or_matches_nothing_has_no_depth() -> None:
    left, right = photographed(CAMERA, 5.0, np.random.default_rng(1))
    stereo = DenseStereo(perfect(CAMERA), 25.0)
    assert CAMERA.fx * CAMERA.baseline / 5.0 > 25.0
    assert (stereo.compute_depth(left, right).depth > 0).mean() < 0.01
    noise = np.random.default_rng(2).integers(0, 256, (2, CAMERA.height, CAMERA.width), dtype=np.uint8)
    assert (stereo.compute_depth(*noise).depth > 0).mean() < 0.05
    assert not stereo.compute_depth(np.zeros_like(left), np.zeros_like(left)).depth.any()


def test_a_shrunk_camera_sees_the_middle_of_each_block_of_pixels_along_the_same_ray() -> None:
    small = downscale_camera(KITTI, 2)
    blocks = rays(KITTI)[:376, :1240].reshape(188, 2, 620, 2, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(rays(small), blocks, atol=1e-12)


def test_the_calibration_error_is_taken_out_before_matching() -> None:
    """Rows 1.5 pixels apart, columns 2 off, and a lens that bends: a depth without knowing is wrong or none."""
    coefficients = np.zeros(NUM_COEFFICIENTS)
    coefficients[0], coefficients[NUM_DISTORTION], coefficients[NUM_DISTORTION + 6] = -12.0, 2.0, 1.5
    calibration = Calibration(CAMERA, coefficients, CalibrationConfig().prior(CAMERA))
    left, right = photographed(CAMERA, 12.0, np.random.default_rng(3))
    u, v = np.meshgrid(np.arange(CAMERA.width, dtype=float), np.arange(CAMERA.height, dtype=float))
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)
    sources = [side.reshape(*left.shape, 2).astype(np.float32) for side in calibration.rectify(pixels, pixels)]
    bent = [cv2.remap(image, to, None, cv2.INTER_CUBIC) for image, to in zip((left, right), sources, strict=True)]
    truth = CAMERA.fx * CAMERA.baseline / 12.0

    def right_share(known: Calibration) -> float:
        return float((np.abs(DenseStereo(known, 25.0).compute_depth(*bent).depth - truth) < 0.3).mean())

    assert right_share(calibration) > 0.7
    assert right_share(perfect(CAMERA)) < 0.1
