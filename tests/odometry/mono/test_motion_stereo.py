"""Depth of any pixels from an earlier image of one camera."""

import numpy as np
import pytest

from odometry import se3
from odometry.distortion import LensDistortion
from odometry.klt_tracking import TrackingConfig, detect_corners, match_brightness
from odometry.mono.motion_stereo import Depths, MotionStereoConfig, PosedImage, estimate_depths, select_earlier_image

CONFIG = MotionStereoConfig()


def posed(world, *tangents):
    poses = [se3.exp(np.array(xi, dtype=float)) for xi in tangents]
    return [PosedImage(world.pair(T)[0], T) for T in poses]


def test_depths_are_those_of_the_panels(world, camera):
    then, now = posed(world, [0, 0, 0, 0, 0, 0], [0, 0.01, 0, 0.4, 0, 0.3])
    lens = LensDistortion(camera, np.zeros(3), np.eye(3))
    pixels = detect_corners(now.image, np.zeros((0, 2)), TrackingConfig(max_corners=150))
    known = pixels[:3], np.full(3, 1 / 16.0)
    depths = estimate_depths((then, now), pixels, known, lens, CONFIG)
    found = np.isfinite(depths.inverse)
    assert found.mean() > 0.5
    points = se3.transform(now.T_map_camera, lens.rays(pixels[found]) / depths.inverse[found, None])
    panels = np.array([26.0, 20.0, 14.0, 11.0, 16.0, 17.0, 60.0])
    nearest = panels[np.argmin(np.abs(np.log(points[:, 2:] / panels)), axis=1)]
    assert np.median(np.abs(points[:, 2] / nearest - 1)) < 0.02
    assert (depths.baseline[found] > 0.1).all()
    assert (depths.baseline[~found] == 0).all()


def test_the_earlier_image_is_the_farthest_one_that_shows_much_the_same(world):
    near, far, too_far, turned, now = posed(
        world, [0, 0, 0, 0, 0, 2.5], [0, 0, 0, 0, 0, 1], [0, 0, 0, 0, 0, -9], [0, 0.5, 0, 0, 0, 0], [0, 0, 0, 0, 0, 3]
    )
    chosen = select_earlier_image([too_far, far, turned, near], now, 15.0, CONFIG)
    assert chosen is far
    assert select_earlier_image([too_far, turned], now, 15.0, CONFIG) is None
    assert select_earlier_image([now], now, 15.0, CONFIG) is None  # no distance, no depth


def test_unknown_depths_are_nan():
    depths = Depths.unknown(3)
    assert np.isnan(depths.inverse).all()
    assert not depths.baseline.any()


@pytest.mark.parametrize(("gain", "offset"), [(0.5, 40), (0.8, -5)])
def test_matched_images_have_the_same_mean_and_contrast(world, gain, offset):
    reference = world.pair(np.eye(4))[0]
    other = np.clip(gain * reference.astype(float) + offset, 0, 255).astype(np.uint8)
    matched = match_brightness(reference, other).astype(float)
    assert abs(matched.mean() - reference.mean()) < 2.0
    assert abs(matched.std() / reference.std() - 1) < 0.05
